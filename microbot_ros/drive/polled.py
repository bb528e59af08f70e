"""Base of drivers for devices that answer only when asked.

What is said to a device is written down as talks, generators of exchanges, and carried out a step
at a time: however slow a line is, `poll` returns when it promised to, so that the dead-man of
whoever calls it is never late, and a zero goes ahead of whatever is being said.
"""

from __future__ import annotations

import math
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from microbot_ros.drive.amplifier import COILS, Amplifier, Command, Counters
from microbot_ros.drive.errors import NoAnswerError
from microbot_ros.drive.transport import Port
from microbot_ros.errors import InputError

_ATTEMPTS = 2
"""All requests set or ask for absolute values, so a damaged exchange may simply be repeated."""
_INSPECT_S = 0.5
"""How often to ask what is wrong with the device: heat takes seconds, and lines are slow."""
_STRAY_S = 0.03
"""How long answers that nobody waits for any more are let come in."""


@dataclass(frozen=True)
class Exchange:
    """One request on each line, side by side, and what `parse` makes of each answer: None as long
    as it is incomplete. `expected` names the answer for people. Where there is no `parse` there
    is no answer, and the lines are left alone for `rest_s`.
    """

    requests: Sequence[bytes]
    parse: Callable[[bytes], Any | None] | None = None
    expected: str = ''
    rest_s: float = 0.0


Result = TypeVar('Result')
Talk = Generator[Exchange, list[Any], Result]
"""Gives exchanges, is given the parsed answers of each, one a line, and returns what it found."""


class PolledAmplifier(Amplifier):
    """Asks for the currents after each command and at least every `period_s`.

    `url` names its ports, `full_scale_A` [A] the current of a channel at full output, of so many
    `channels`.
    """

    channels_per_port = 0
    """How many channels a serial line serves; 0 for all."""
    baud = 115_200
    xon_xoff = False
    period_s = 0.02
    reply_s = 0.03
    """How long a device may take to answer: twice what a USB adapter holds bytes back at most."""
    gap_s = 0.0
    """The silence that ends a request, where nothing else does."""

    def __init__(self, url: str, full_scale_A: float | Sequence[float],
                 channels: int = len(COILS)) -> None:
        super().__init__(url, full_scale_A, channels)
        per_port = self.channels_per_port or channels
        self.ports = math.ceil(channels / per_port)
        """How many serial lines it takes."""
        self._urls = url.split(',')
        if len(self._urls) != self.ports:
            raise InputError(url, f'expected {self.ports} serial ports, separated by commas')
        self._lines: list[Port] = []
        self._woken = threading.Event()
        self._measured: list[tuple[float, float, np.ndarray]] = []
        self._forget()

    def _forget(self) -> None:
        self._order: Command | None = None  # the newest, until it goes out
        self._flowing = False
        self._delivered_s = time.monotonic()
        self._due_s = 0.0
        self._inspection_s = self._delivered_s + _INSPECT_S
        self._begin_again()

    def _begin_again(self, first: Exchange | None = None) -> None:
        self._agenda = self._say_all(first)
        self._asked: _Asked | None = None
        self._answers: list[Any] | None = None

    @abstractmethod
    def _identify(self) -> Talk[None]:
        """Make sure of the device, arm its watchdog and enable its outputs at zero."""

    @abstractmethod
    def _drive(self, currents_A: np.ndarray) -> Talk[None]:
        """Set the currents."""

    @abstractmethod
    def _measure(self) -> Talk[np.ndarray]:
        """Ask for the currents."""

    @abstractmethod
    def _zeros(self) -> list[bytes]:
        """For each line what zeroes its coils in one go, whatever was said before."""

    def _inspect(self) -> Talk[str]:
        """What the device says is wrong with it; '' where nothing is, or where it cannot tell."""
        yield from ()
        return ''

    def _switch_off(self) -> Talk[None]:
        """Switch the outputs off, where the device can."""
        yield from ()

    def wake(self) -> None:
        self._woken.set()
        for port in self._lines.copy():
            port.wake()

    def last_words(self) -> list[tuple[int, bytes]]:
        self._require_lines()
        return [(port.descriptor, zero) for port, zero
                in zip(self._lines, self._zeros(), strict=True) if port.descriptor is not None]

    def _open(self) -> None:
        self._forget()
        for url in self._urls:
            self._lines.append(Port(url, self.baud, xon_xoff=self.xon_xoff))
        self._finish(self._identify())
        self.fault = self._finish(self._inspect())

    def _send(self, command: Command) -> None:
        self._require_lines()
        flows = bool(np.any(command.currents_A))
        if self._flowing and not flows:
            self._zero_at_once()
        self._flowing, self._order = flows, command
        self.counters.frames_sent += 1

    def _zero_at_once(self) -> None:
        """Ahead of all that is being said, whose answers are let pass; in its turn it is said
        again, and made sure of."""
        time.sleep(self.gap_s)
        for port, zero in zip(self._lines, self._zeros(), strict=True):
            port.send(zero)
        self._begin_again(Exchange((), rest_s=_STRAY_S))

    def _receive(self, timeout_s: float) -> list[tuple[float, float, np.ndarray]]:
        self._require_lines()
        until_s = time.monotonic() + timeout_s
        while not (self._measured or self._woken.is_set()):
            self._go_on(until_s)
            if time.monotonic() >= until_s:
                break
        self._woken.clear()
        measured = self._measured.copy()
        self._measured.clear()
        self.counters.frames_received += len(measured)
        return measured

    def _go_on(self, until_s: float) -> None:
        """Say what is next, or hear what comes, until then at the latest."""
        if self._asked is None:
            exchange, self._answers = self._agenda.send(self._answers), None
            if exchange is None:
                if not self._measured:
                    self._woken.wait(max(min(self._due_s, until_s) - time.monotonic(), 0.0))
                return
            self._asked = self._ask(exchange)
        self._answers = self._asked.answers(until_s)
        if self._answers is not None:
            self._asked = None

    def _say_all(self, first: Exchange | None) -> Generator[Exchange | None, Any, None]:
        """After what comes first, for ever in turn: the newest currents, the question for the
        measured ones, one exchange of the inspection; None where there is nothing to say now."""
        yield first
        inspection = self._inspect_again()
        inspected: list[Any] | None = None
        while True:
            if (command := self._order) is not None:
                self._order = None
                yield from self._drive(command.currents_A)
                self._delivered_s = command.t_monotonic_s
            elif time.monotonic() < self._due_s:
                yield None
                continue
            self._due_s, since_s = time.monotonic() + self.period_s, self._delivered_s
            currents = yield from self._measure()
            self._measured.append((time.monotonic(), since_s, currents))
            if (question := inspection.send(inspected)) is not None:
                inspected = yield question

    def _inspect_again(self) -> Generator[Exchange | None, Any, None]:
        while True:
            if time.monotonic() < self._inspection_s:
                yield None
            else:
                self.fault = yield from self._inspect()
                self._inspection_s = time.monotonic() + _INSPECT_S

    def _finish(self, talk: Talk[Result]) -> Result:
        """Have one talk, and wait for its end."""
        answers: Any = None
        try:
            while True:
                asked = self._ask(talk.send(answers))
                while (answers := asked.answers(math.inf)) is None:
                    pass
        except StopIteration as end:
            result: Result = end.value
            return result

    def _ask(self, exchange: Exchange) -> _Asked:
        patience_s = self.reply_s if exchange.parse else exchange.rest_s
        return _Asked(exchange, self._lines, patience_s, self.counters)

    def _disable(self) -> None:
        if self._lines:
            self._finish(self._switch_off())

    def _release(self) -> None:
        while self._lines:
            self._lines.pop().close()

    def _require_lines(self) -> None:
        if not self._lines:
            raise NoAnswerError(self.url, 'a connection')


class _Asked:
    """An exchange under way: sent now, and once more on each line whose answer stays away."""

    def __init__(self, exchange: Exchange, lines: Sequence[Port], patience_s: float,
                 counters: Counters) -> None:
        self._exchange, self._lines = exchange, lines
        self._patience_s, self._counters = patience_s, counters
        self._attempts = 0
        self._parsed: dict[int, Any] = {}
        self._send()

    def answers(self, until_s: float) -> list[Any] | None:
        """The answers, one a line; None if they are not complete by then, or when woken.

        Raises NoAnswerError where nothing usable comes back from repeated attempts.
        """
        if self._exchange.parse is None:
            time.sleep(max(min(self._deadline_s, until_s) - time.monotonic(), 0.0))
            return [] if time.monotonic() >= self._deadline_s else None
        while (line := self._open_line()) is not None:
            data = self._lines[line].receive(min(self._deadline_s, until_s) - time.monotonic())
            self._received[line] += data
            answer = self._exchange.parse(self._received[line]) if data else None
            if answer is not None:
                self._parsed[line] = answer
            elif time.monotonic() >= self._deadline_s:
                self._try_again(line)
            elif not data:
                return None
        return [self._parsed[line] for line in range(len(self._lines))]

    def _open_line(self) -> int | None:
        return next((line for line in range(len(self._lines)) if line not in self._parsed), None)

    def _send(self) -> None:
        self._attempts += 1
        self._deadline_s = time.monotonic() + self._patience_s
        self._received = [b''] * len(self._lines)
        for line, request in enumerate(self._exchange.requests):
            if line not in self._parsed:
                self._lines[line].discard_input()
                self._lines[line].send(request)

    def _try_again(self, missing: int) -> None:
        self._counters.crc_errors += sum(map(bool, self._received))
        self._counters.discarded_bytes += sum(map(len, self._received))
        if self._attempts == _ATTEMPTS:
            raise NoAnswerError(self._lines[missing].url, self._exchange.expected)
        self._send()
