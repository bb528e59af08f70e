"""Base of drivers for devices that answer only when asked.

What is said to a device is written down as talks, generators of exchanges, and carried out a step
at a time: however slow a line is, `poll` returns when it promised to, so that the dead-man of
whoever calls it is never late, and a zero goes ahead of whatever is being said.

A driver describes the talk with one device. Devices on lines of their own are talked to side by
side, those that share a line one after the other, and what fails with one of them keeps no zero
from the others.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.drive.amplifier import COILS, Amplifier, Command, Counters, Zero
from microbot_ros.drive.clock import Clock
from microbot_ros.drive.errors import (
    AmplifierError,
    NoAnswerError,
    UnreachableError,
    WrongDeviceError,
)
from microbot_ros.drive.transport import AbsentPort, Port

_ATTEMPTS = 2
"""All requests set or ask for absolute values, so a damaged exchange may simply be repeated."""
_INSPECT_S = 0.5
"""How often to ask what is wrong with the device: heat takes seconds, and lines are slow."""
_STRAY_S = 0.03
"""How long answers that nobody waits for any more are let come in."""


@dataclass(frozen=True)
class Exchange:
    """One `request` and what `parse` makes of the answer: None as long as it is incomplete.

    `expected` names the answer for people. Where there is no `parse` there is no answer, and the
    line is left alone for `rest_s` [s].
    """

    request: bytes
    parse: Callable[[bytes], Any | None] | None = None
    expected: str = ''
    rest_s: float = 0.0


Result = TypeVar('Result')
Talk = Generator[Exchange, Any, Result]
"""Yields exchanges with one device, is sent the parsed answer of each, and returns its result."""
Round = dict[int, Exchange]
"""Line → the exchange on it, all side by side."""
Rounds = Generator[Round | None, Any, Result]
"""Yields rounds, is sent line → answer or AmplifierError for each, and returns its result."""


class PolledAmplifier(Amplifier):
    """Asks for the currents after each command and at least every `period_s`.

    `url` names its ports, `full_scale_A` [A] the current of a channel at full output, of so many
    `channels`.
    """

    channels_per_device = 1
    share_a_line = False
    """Whether all devices are on one serial line; else each has its own."""
    baud = 115_200
    xon_xoff = False
    queues = False
    """Whether the line is so slow that a zero would wait behind what was said before."""
    period_s = 0.02
    reply_s = 0.03
    """How long a device may take to answer: twice what a USB adapter holds bytes back at most."""
    gap_s = 0.0
    """The silence that ends a request, where nothing else does."""
    zero_again = b''
    """Request that repeats a zero while an answer is awaited; empty where a device takes none."""

    def __init__(self, url: str, full_scale_A: float | Sequence[float],
                 channels: int = len(COILS)) -> None:
        super().__init__(url, full_scale_A, channels)
        self.devices = range(math.ceil(channels / self.channels_per_device))
        ports = 1 if self.share_a_line else len(self.devices)
        self.urls = tuple(url.split(','))
        if len(self.urls) != ports:
            raise InputError(url, f'expected {ports} serial ports, separated by commas')
        self._measured: list[tuple[float, float, np.ndarray]] = []
        self._forget()

    def _forget(self) -> None:
        self._order: Command | None = None  # the newest, until it goes out
        self._flowing = False
        self._delivered_s = self.clock.now()
        self._due_s = 0.0
        self._inspection_s = self._delivered_s + _INSPECT_S
        self._begin_again()

        self._others: set[int] = set()  # devices that are not what is expected

    def _begin_again(self, first: Round | None = None) -> None:
        self._agenda = self._say_all(first)
        self._asked: _Asked | None = None
        self._answers: dict[int, Any] | None = None

    @abstractmethod
    def _identify(self, device: int) -> Talk[None]:
        """Make sure of a device. Raises WrongDeviceError, after which nothing is sent to it."""

    def _configure(self, device: int) -> Talk[None]:
        """Zero the device and arm its watchdog, once all devices are identified."""
        yield from ()

    def _enable(self, device: int) -> Talk[None]:
        """Enable the outputs of a device, once all devices are configured."""
        yield from ()

    @abstractmethod
    def _drive(self, device: int, currents_A: np.ndarray) -> Talk[None]:
        """Set the currents [A] of a device, one for each of its channels but for a spare one."""

    @abstractmethod
    def _measure(self, device: int) -> Talk[Sequence[float]]:
        """Ask a device for its currents [A], (`channels_per_device`,)."""

    def _inspect(self, device: int) -> Talk[str]:
        """What a device says is wrong with it; '' where nothing is, or where it cannot tell."""
        yield from ()
        return ''

    def _switch_off(self, device: int) -> Talk[None]:
        """Switch the outputs of a device off, where it can."""
        yield from ()

    def _duties(self, device: int, currents_A: np.ndarray) -> list[float]:
        """The currents [A] of a device as parts of full scale, with 0 for a spare channel."""
        scale = self._part(device, self.full_scale_A)
        duties: list[float] = (currents_A[:len(scale)] / scale).tolist()
        return duties + [0.0] * (self.channels_per_device - len(duties))

    def _part(self, device: int, values: np.ndarray) -> np.ndarray:
        """What of `values` (N,) belongs to a device: nothing for a spare channel."""
        begin = device * self.channels_per_device
        return values[begin:begin + self.channels_per_device]

    def _line(self, device: int) -> int:
        return 0 if self.share_a_line else device

    # Opening and ending, device by device -----------------------------------------------------

    def _open(self) -> None:
        self._forget()
        for line, url in enumerate(self.urls):
            try:
                port = self._open_port(url, self.baud, xon_xoff=self.xon_xoff)
            except UnreachableError as error:
                port = AbsentPort(error)
            self._lines.append(port)
            if self._known:
                self._zero_lines([line])  # the first device on it has its number
        if self._known:
            self._require_ports()
        found = self._with_each(self._identify)
        self._others = {device for device, result in found.items()
                        if isinstance(result, WrongDeviceError)}
        self._require(found)
        self._require(self._with_each(self._configure))
        self._require(self._with_each(self._enable))
        found = self._require(self._with_each(self._inspect))
        self.fault = _joined(found)

    def _require_ports(self) -> None:
        """Raise at once for a port that is away: the next attempt shall not be late for it."""
        for port in self._lines:
            if isinstance(port, AbsentPort):
                raise port.error

    def _require(self, found: dict[int, Any]) -> dict[int, Any]:
        """The results of talks; raises the first error among them, with all ports noted."""
        errors = [result for result in found.values() if isinstance(result, AmplifierError)]
        self._lose_all(errors)
        for error in errors:
            raise error
        return found

    def _abort(self, error: BaseException) -> None:
        reached = [device for device in self.devices if device not in self._others]
        # An attempt to reconnect is repeated soon, and the zero with it; the first is not.
        if self._lines:
            self._make_safe(reached, 0.0 if self._known else self.read_back_s)

    def _end(self) -> Zero:
        self.counters.frames_sent += 1
        return self._make_safe(self.devices, self.read_back_s)

    def _make_safe(self, devices: Sequence[int], patience_s: float) -> Zero:
        """Zero these devices, read back for `patience_s` [s] and disable them; return the worst
        that holds of one.
        """
        self._zero_lines(devices)
        self._carry_out(self._let_strays_in())
        until_s = self.clock.now() + patience_s
        waiting = set(devices)
        while waiting and (began_s := self.clock.now()) < until_s:
            # What is damaged or lost is said again in the next pass, the zero with it.
            sent = self._with_each(self._zero, waiting, attempts=1)
            found = self._with_each(partial(self._is_at_zero, until_s=until_s), waiting,
                                    attempts=1)
            self._lose_all((*sent.values(), *found.values()))
            waiting -= {device for device in found
                        if found[device] is True or self._out_of_reach(device)}
            self.clock.sleep(began_s + self.period_s - self.clock.now() if waiting else 0.0)
        self._lose_all(self._with_each(self._switch_off, devices).values())
        if self.unreachable:
            return Zero.UNREACHABLE
        return Zero.SENT if waiting else Zero.CONFIRMED

    def _zero(self, device: int) -> Talk[None]:
        return self._drive(device, np.zeros(self.channels_per_device))

    def _is_at_zero(self, device: int, until_s: float) -> Talk[bool]:
        if self.clock.now() >= until_s:
            return False
        measured = np.asarray((yield from self._measure(device)))
        tolerance_A = self._part(device, self._tolerance_A)
        return bool(np.all(np.abs(measured[:len(tolerance_A)]) <= tolerance_A))

    def _out_of_reach(self, device: int) -> bool:
        return self.urls[self._line(device)] in self.unreachable

    def _lose_all(self, results: Iterable[Any]) -> None:
        for result in results:
            if isinstance(result, UnreachableError):
                self._lose(result)

    # Driving ------------------------------------------------------------------------------------

    def _send(self, command: Command) -> None:
        self._require_lines()
        flows = bool(np.any(command.currents_A))
        ahead = self._flowing and not flows
        beside = self.zero_again and not (flows or self._flowing or self._order)
        self._flowing, self._order = flows, command
        self.counters.frames_sent += 1
        error = None
        if ahead:
            error = self._zero_lines(self.devices)
        elif beside and self._asked is not None:
            self._order = None
            error = self._send_to(dict.fromkeys(range(len(self._lines)), self.zero_again))
        if error is not None:
            raise error

    def _zero_lines(self, devices: Iterable[int]) -> AmplifierError | None:
        """Zero the lines of these devices ahead of all that is being said, whose answers are let
        pass; in its turn a zero is said again, and made sure of. Return the first error, once a
        zero was sent on every other line.
        """
        self._flowing = False
        self.clock.sleep(self.gap_s)
        zeros = self._zeros()
        error = self._send_to({line: zeros[line] for line in sorted(map(self._line, devices))},
                              discard=self.queues)
        self._begin_again(self._strays())
        return error

    def _send_to(self, requests: dict[int, bytes], *, discard: bool = False,
                 ) -> AmplifierError | None:
        """Send each line its request, with `discard` in place of what has not gone out; return the
        first error, once every other line was sent its own.
        """
        errors = []
        for line, request in requests.items():
            try:
                if discard:
                    self._lines[line].discard_output()
                self._lines[line].send(request)
            except UnreachableError as error:
                errors.append(error)
        self._lose_all(errors)
        return errors[0] if errors else None

    def _strays(self) -> Round:
        return {line: Exchange(b'', rest_s=_STRAY_S) for line in range(len(self._lines))}

    def _let_strays_in(self) -> Rounds[None]:
        yield self._strays()

    def _receive(self, timeout_s: float) -> list[tuple[float, float, np.ndarray]]:
        self._require_lines()
        until_s = self.clock.now() + timeout_s
        try:
            while not (self._measured or self._woken.is_set()):
                self._go_on(until_s)
                if self.clock.now() >= until_s:
                    break
        except AmplifierError:
            self._order = None
            self._zero_lines(self.devices)
            raise
        self._woken.clear()
        measured = self._measured.copy()
        self._measured.clear()
        self.counters.frames_received += len(measured)
        return measured

    def _go_on(self, until_s: float) -> None:
        """Say what is next, or hear what comes, until then at the latest."""
        if self._asked is None:
            exchanges, self._answers = self._agenda.send(self._answers), None
            if exchanges is None:
                if not self._measured:
                    self.clock.wait(self._woken, min(self._due_s, until_s) - self.clock.now())
                return
            self._asked = self._ask(exchanges)
        self._answers = self._asked.answers(until_s)
        self._require(self._asked.heard)
        if self._answers is not None:
            self._asked = None

    def _say_all(self, first: Round | None) -> Rounds[None]:
        """After what comes first, for ever in turn: the newest currents, the question for the
        measured ones, one round of the inspection; None where there is nothing to say now."""
        yield first
        inspection = self._inspect_again()
        inspected: dict[int, Any] | None = None
        while True:
            if (command := self._order) is not None:
                self._order = None
                yield from self._talk_to(
                    self.devices, partial(self._drive_part, command.currents_A))
                self._delivered_s = command.t_monotonic_s
            elif self.clock.now() < self._due_s:
                yield None
                continue
            self._due_s, since_s = self.clock.now() + self.period_s, self._delivered_s
            found = yield from self._talk_to(self.devices, self._measure)
            currents = np.ravel(list(found.values()))[:self.channels]
            self._measured.append((self.clock.now(), since_s, currents))
            if (question := inspection.send(inspected)) is not None:
                inspected = yield question

    def _drive_part(self, currents_A: np.ndarray, device: int) -> Talk[None]:
        return self._drive(device, self._part(device, currents_A))

    def _inspect_again(self) -> Rounds[None]:
        while True:
            if self.clock.now() < self._inspection_s:
                yield None
            else:
                found = yield from self._talk_to(self.devices, self._inspect)
                self.fault = _joined(found)
                self._inspection_s = self.clock.now() + _INSPECT_S

    # Carrying out talks -------------------------------------------------------------------------

    def _talk_to(self, devices: Iterable[int], talk: Callable[[int], Talk[Result]],
                 ) -> Rounds[dict[int, Result | AmplifierError]]:
        """Have a talk with each of these devices, side by side where their lines are."""
        if not self.share_a_line:
            return (yield from _side_by_side({device: talk(device) for device in devices}))
        found: dict[int, Result | AmplifierError] = {}
        for device in devices:
            result = yield from _side_by_side({0: talk(device)})
            found[device] = result[0]
        return found

    def _with_each(self, talk: Callable[[int], Talk[Result]], devices: Iterable[int] | None = None,
                   attempts: int = _ATTEMPTS) -> dict[int, Result | AmplifierError]:
        """Device → the result of a talk with it, or its error, once all have ended."""
        return self._carry_out(
            self._talk_to(self.devices if devices is None else sorted(devices), talk), attempts)

    def _carry_out(self, rounds: Rounds[Result], attempts: int = _ATTEMPTS) -> Result:
        answers: dict[int, Any] | None = None
        try:
            while True:
                asked = self._ask(rounds.send(answers) or {}, attempts)
                while (answers := asked.answers(math.inf)) is None:
                    pass
        except StopIteration as end:
            result: Result = end.value
            return result

    def _ask(self, exchanges: Round, attempts: int = _ATTEMPTS) -> _Asked:
        return _Asked(exchanges, self._lines, self.reply_s, attempts, self.counters, self.clock)


def _side_by_side(talks: dict[int, Talk[Result]]) -> Rounds[dict[int, Result | AmplifierError]]:
    """Have talks on several lines at once, a round at a time; line → result or error."""
    found: dict[int, Result | AmplifierError] = {}
    going_on, answers = dict(talks), dict.fromkeys(talks)
    while going_on:
        exchanges: Round = {}
        for line, talk in list(going_on.items()):
            try:
                exchanges[line] = _next(talk, answers[line])
            except StopIteration as end:
                found[line] = end.value
                del going_on[line]
            except AmplifierError as error:
                found[line] = error
                del going_on[line]
        if exchanges:
            answers = yield exchanges
    return {line: found[line] for line in talks}


def _joined(found: dict[int, Any]) -> str:
    return '; '.join(filter(None, found.values()))


def _next(talk: Talk[Any], answer: Any) -> Exchange:
    return talk.throw(answer) if isinstance(answer, AmplifierError) else talk.send(answer)


class _Asked:
    """Exchanges under way, one a line: sent now, and again where the answer stays away."""

    def __init__(self, exchanges: Round, lines: Sequence[Port], reply_s: float, attempts: int,
                 counters: Counters, clock: Clock) -> None:
        self._exchanges, self._lines, self._counters = exchanges, lines, counters
        self._reply_s, self._attempts, self._clock = reply_s, attempts, clock
        self._left = dict.fromkeys(exchanges, attempts)
        self._deadline_s = dict.fromkeys(exchanges, 0.0)
        self._received = dict.fromkeys(exchanges, b'')
        self.heard: dict[int, Any] = {}
        """Line → answer or error, of those that have one already."""
        for line in exchanges:
            self._send(line)

    def answers(self, until_s: float) -> dict[int, Any] | None:
        """Line → answer, or the AmplifierError of a line that is lost or has none after repeated
        attempts; None if they are not complete by then, or when woken.
        """
        while (line := self._open_line()) is not None:
            try:
                if not self._hear(line, until_s):
                    return None
            except UnreachableError as error:
                self.heard[line] = error
        return {line: self.heard[line] for line in self._exchanges}

    def _open_line(self) -> int | None:
        return next((line for line in self._exchanges if line not in self.heard), None)

    def _hear(self, line: int, until_s: float) -> bool:
        """Take what a line has to say; False for nothing yet."""
        exchange, deadline_s = self._exchanges[line], self._deadline_s[line]
        left_s = min(deadline_s, until_s) - self._clock.now()
        if exchange.parse is None:
            self._clock.sleep(left_s)
            if self._clock.now() >= deadline_s:
                self.heard[line] = None
            return line in self.heard
        data = self._lines[line].receive(left_s)
        self._received[line] += data
        answer = exchange.parse(self._received[line]) if data else None
        if answer is not None:
            self.heard[line] = answer
        elif self._clock.now() >= deadline_s:
            self._try_again(line)
        else:
            return bool(data)
        return True

    def _send(self, line: int) -> None:
        exchange = self._exchanges[line]
        self._left[line] -= 1
        patience_s = self._reply_s if exchange.parse else exchange.rest_s
        self._deadline_s[line] = self._clock.now() + patience_s
        self._received[line] = b''
        if not exchange.request:
            return
        try:
            self._lines[line].discard_input()
            self._lines[line].send(exchange.request)
        except UnreachableError as error:
            self.heard[line] = error

    def _try_again(self, line: int) -> None:
        self._counters.crc_errors += bool(self._received[line])
        self._counters.discarded_bytes += len(self._received[line])
        if self._left[line]:
            self._send(line)
        else:
            self.heard[line] = NoAnswerError(
                self._lines[line].url, self._exchanges[line].expected)
