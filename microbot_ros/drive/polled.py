"""Base of drivers for devices that answer only when asked.

Communication with a device is described as talks, generators of exchanges, and carried out step by
step. However slow a line is, `poll` returns in the promised time, so that the caller's dead-man is
never late, and a zero overtakes whatever is being sent.

A driver describes the talk with one device. Devices on separate lines are talked to in parallel,
those that share a line one after the other, and a failure of one keeps no zero from the others.
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
from microbot_ros.common.patience import PATIENCE
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
"""Number of attempts. Choice: one repetition keeps the answer within the dead-man's time. All
requests set or ask for absolute values, so a damaged exchange may simply be repeated."""
_INSPECT_S = 0.5
"""Interval [s] between questions for faults of the device. Choice: heating takes seconds, and each
question costs a slow line one reading."""
_STRAY_S = 0.03
"""Time [s] during which late answers are let in and discarded. Choice: the longest answer time of
most devices, `PolledAmplifier.reply_s`."""


@dataclass(frozen=True)
class Exchange:
    """One request and the parser of its answer.

    Attributes
    ----------
    request : bytes
        Bytes to send.
    parse : callable or None
        Parser of the bytes received so far; it returns None while the answer is incomplete.
        Without parser no answer is expected, and the line is left alone for `rest_s`.
    expected : str
        Name of the answer, for people.
    rest_s : float
        Time [s] after a request without answer.
    """

    request: bytes
    parse: Callable[[bytes], Any | None] | None = None
    expected: str = ''
    rest_s: float = 0.0


Result = TypeVar('Result')
Talk = Generator[Exchange, Any, Result]
"""Generator that yields exchanges with one device, is sent the parsed answers, and returns its
result."""
Round = dict[int, Exchange]
"""Exchanges in parallel, by line."""
Rounds = Generator[Round | None, Any, Result]
"""Generator that yields rounds, is sent an answer or AmplifierError for each line, and returns its
result."""


class PolledAmplifier(Amplifier):
    """Amplifier that is asked for its currents after each command and at least every `period_s`.

    Parameters
    ----------
    url : str
        Names of its ports, separated by commas.
    full_scale_A : float or sequence of float
        Current of each coil at full output [A]; a scalar applies to all coils.
    channels : int
        Number of coils N.

    Raises
    ------
    InputError
        If the number of ports is not that of the lines.
    """

    channels_per_device = 1
    """Number of channels of one device; drivers set that of their device."""
    share_a_line = False
    """Whether all devices are on one serial line; otherwise each has its own."""
    baud = 115_200
    """Rate of the line [1/s]. Choice: the most common rate of USB adapters; drivers set that of
    their device."""
    xon_xoff = False
    queues = False
    """Whether the line is so slow that a zero would wait behind bytes sent before."""
    period_s = 0.02
    """Longest interval [s] between questions for currents. Choice: the 50 Hz of boards that report
    unasked."""
    reply_s = 0.03
    """Longest time [s] until a device answers. Choice: twice the longest delay of a USB adapter
    (16 ms)."""
    gap_s = 0.0
    """Silence [s] that ends a request; 0 where the request ends by itself."""
    zero_again = b''
    """Request that repeats a zero while an answer is awaited; empty if a device accepts none."""

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
        self._order: Command | None = None  # the newest command, until it is sent
        self._flowing = False
        self._delivered_s = self.clock.now()
        self._due_s = 0.0
        self._inspection_s = self._delivered_s + _INSPECT_S
        self._begin_again()

        self._others: set[int] = set()  # wrong devices

    def _begin_again(self, first: Round | None = None) -> None:
        self._agenda = self._say_all(first)
        self._asked: _Asked | None = None
        self._answers: dict[int, Any] | None = None

    @abstractmethod
    def _identify(self, device: int) -> Talk[None]:
        """Identify a device; raise WrongDeviceError, after which nothing is sent to the device."""

    def _configure(self, device: int) -> Talk[None]:
        """Zero the device and arm its watchdog, once all devices are identified."""
        yield from ()

    def _enable(self, device: int) -> Talk[None]:
        """Enable the outputs of a device, once all devices are configured."""
        yield from ()

    @abstractmethod
    def _drive(self, device: int, currents_A: np.ndarray) -> Talk[None]:
        """Set the currents [A] of a device, one for each of its channels except spare ones."""

    @abstractmethod
    def _measure(self, device: int) -> Talk[Sequence[float]]:
        """Ask a device for its currents [A], (`channels_per_device`,)."""

    def _inspect(self, device: int) -> Talk[str]:
        """Return the fault that a device reports; '' if there is none or if it reports none."""
        yield from ()
        return ''

    def _switch_off(self, device: int) -> Talk[None]:
        """Switch the outputs of a device off, if it can."""
        yield from ()

    def _duties(self, device: int, currents_A: np.ndarray) -> list[float]:
        """Return the currents [A] of a device as parts of full scale; 0 for a spare channel."""
        scale = self._part(device, self.full_scale_A)
        duties: list[float] = (currents_A[:len(scale)] / scale).tolist()
        return duties + [0.0] * (self.channels_per_device - len(duties))

    def _part(self, device: int, values: np.ndarray) -> np.ndarray:
        """Return the part of `values` (N,) that belongs to a device, without spare channels."""
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
        """Raise at once for an absent port, so that the next attempt is not late."""
        for port in self._lines:
            if isinstance(port, AbsentPort):
                raise port.error

    def _require(self, found: dict[int, Any]) -> dict[int, Any]:
        """Return the results of talks; raise the first error after noting all lost ports."""
        errors = [result for result in found.values() if isinstance(result, AmplifierError)]
        self._lose_all(errors)
        for error in errors:
            raise error
        return found

    def _abort(self, error: BaseException) -> None:
        reached = [device for device in self.devices if device not in self._others]
        # An attempt to reconnect is repeated soon, with its zero; the first one is not.
        if self._lines:
            self._make_safe(reached, 0.0 if self._known else PATIENCE.read_back_s)

    def _end(self) -> Zero:
        self.counters.frames_sent += 1
        return self._make_safe(self.devices, PATIENCE.read_back_s)

    def _make_safe(self, devices: Sequence[int], patience_s: float) -> Zero:
        """Zero these devices, read back and disable them; return the worst state of any.

        The read-back lasts `patience_s` [s] at most.
        """
        self._zero_lines(devices)
        self._carry_out(self._let_strays_in())
        until_s = self.clock.now() + patience_s
        waiting = set(devices)
        while waiting and (began_s := self.clock.now()) < until_s:
            # Damaged or lost requests, zeros too, are repeated in the next pass.
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
        """Zero the lines of these devices before everything else; return the first error.

        The error is returned after a zero was sent on every other line. Answers to earlier
        requests are let pass; a zero is sent again and confirmed in the regular sequence.
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
        """Send each line its request; return the first error after sending to all lines.

        With `discard` it replaces bytes that have not gone out.
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
        """Send the next round, or receive answers, until `until_s` at the latest."""
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
        """Yield the first round, then in an endless cycle all others; None if nothing is due.

        The cycle is: the newest currents, the question for the measured ones, one round of the
        inspection.
        """
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
                self.fault = _joined(self._require(found))
                self._inspection_s = self.clock.now() + _INSPECT_S

    # Carrying out talks -------------------------------------------------------------------------

    def _talk_to(self, devices: Iterable[int], talk: Callable[[int], Talk[Result]],
                 ) -> Rounds[dict[int, Result | AmplifierError]]:
        """Talk to each of these devices, in parallel where they have separate lines."""
        if not self.share_a_line:
            return (yield from _side_by_side({device: talk(device) for device in devices}))
        found: dict[int, Result | AmplifierError] = {}
        for device in devices:
            result = yield from _side_by_side({0: talk(device)})
            found[device] = result[0]
        return found

    def _with_each(self, talk: Callable[[int], Talk[Result]], devices: Iterable[int] | None = None,
                   attempts: int = _ATTEMPTS) -> dict[int, Result | AmplifierError]:
        """Return the result of a talk, or its error, by device, after all have ended."""
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
    """Hold talks on several lines in parallel, round by round; return result or error by line."""
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
    """Exchanges in progress, one per line: sent now, and again if no answer arrives."""

    def __init__(self, exchanges: Round, lines: Sequence[Port], reply_s: float, attempts: int,
                 counters: Counters, clock: Clock) -> None:
        self._exchanges, self._lines, self._counters = exchanges, lines, counters
        self._reply_s, self._clock = reply_s, clock
        self._left = dict.fromkeys(exchanges, attempts)
        self._deadline_s = dict.fromkeys(exchanges, 0.0)
        self._received = dict.fromkeys(exchanges, b'')
        self.heard: dict[int, Any] = {}
        """Answer or error by line, of the lines that have one."""
        for line in exchanges:
            self._send(line)

    def answers(self, until_s: float) -> dict[int, Any] | None:
        """Return the answer or AmplifierError by line; None if incomplete or if woken.

        It waits until `until_s` at the latest. An AmplifierError stands for a line that is lost or
        has no answer after repeated attempts.
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
        """Process the bytes of a line; return False if there are none yet."""
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
