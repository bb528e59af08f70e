"""What every amplifier driver is: currents out, measured currents back, one for each coil.

Four coils in the plane are in the order +Y, +X, −Y, −X. A driver moves
current in `write` and `zero` only; it keeps no limits but its full scale: those are the gate's.
"""

from __future__ import annotations

import functools
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.plugins import installed
from microbot_ros.drive.adapter import Adapter, adapter_at
from microbot_ros.drive.clock import Clock
from microbot_ros.drive.errors import (
    AmplifierError,
    NoAnswerError,
    UnreachableError,
    WrongDeviceError,
)
from microbot_ros.drive.transport import Port, has_descriptor

COILS = ('coil_plus_y', 'coil_plus_x', 'coil_minus_y', 'coil_minus_x')
"""Names of four coils in the plane, in the order of every array of currents."""

READ_BACK_S = 0.5
"""How long a driver waits for the read-back that proves a zero."""

AGAIN_S = 0.01
"""How soon a zero is sent again that no reading has shown: the line may have damaged it. A line
that damages every other packet then lets one through within 0.1 s in all but one of 1000 cases."""

_AGREEMENT = 0.02
"""How near a reading must be to a command to acknowledge it, as a part of full scale."""


class Watchdog(StrEnum):
    """What zeroes the coils when this computer dies."""

    ARMED = 'set in the device and read back'
    FIRMWARE = 'in the firmware, if it has one: arming tests it'
    UNCONFIRMED = 'set in the device, which does not confirm it'
    NONE = 'none'


class Zero(StrEnum):
    """What is known of a zero that was asked for; each value is the words for people."""

    CONFIRMED = 'zero, confirmed by a reading'
    SENT = 'zero sent, not confirmed'
    UNREACHABLE = 'not reachable'


BY_HAND = 'switch the amplifier off by hand'
"""What a person is to do where coils are not reachable."""


@dataclass(frozen=True, eq=False)
class Swing:
    """Currents of a field that turns: `steady` + `cosine` cos ωt + `sine` sin ωt.

    Each (N,) [A], with ω the `rate` [rad/s] and t [s] since they were sent.
    """

    steady: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    rate: float

    @property
    def largest(self) -> np.ndarray:
        """The largest magnitude of each current on the way (N,) [A]."""
        return np.asarray(np.abs(self.steady) + self.amplitude)

    @property
    def amplitude(self) -> np.ndarray:
        """The amplitude of the part of each current that turns (N,) [A]."""
        return np.hypot(self.cosine, self.sine)


@dataclass(frozen=True, eq=False)
class Command:
    """`currents_A` (N,) [A], handed to the line at `t_monotonic_s`.

    `tag` is the caller's, to know the command again; `swing` is how they go on by themselves.
    """

    t_monotonic_s: float
    currents_A: np.ndarray
    tag: Any = None
    swing: Swing | None = None


@dataclass(frozen=True, eq=False)
class Reading:
    """Measured `currents_A` (N,) [A], which arrived at `t_monotonic_s`.

    `since_s` is when the last command went out that the device had for sure when they were taken:
    every later one may, or may not yet, show in them. `acknowledges` is the oldest command that
    these currents agree with and that no earlier reading has acknowledged; None where there is
    none.
    """

    t_monotonic_s: float
    since_s: float
    currents_A: np.ndarray
    acknowledges: Command | None


@dataclass
class Counters:
    """Traffic since the driver was made: `frames_sent` and `frames_received`, answers whose check
    failed (`crc_errors`) and `discarded_bytes` that belonged to no answer."""

    frames_sent: int = 0
    frames_received: int = 0
    crc_errors: int = 0
    discarded_bytes: int = 0


class Amplifier(ABC):
    """A current source of so many `channels`, one for each of N coils, behind one protocol.

    `url` names its port (for a protocol with several: all, separated by commas) and
    `full_scale_A` the current of each coil at full output (a scalar means all alike).
    One thread calls it, but for `wake`, which any may. InputError for more channels than
    `most_channels`.

    A driver is bound to the USB adapters of its first connection: at a port where another one is
    found later, or whose name under `/dev/serial/by-id/` is not the adapter's, nothing is sent. A
    port without such an identity, as on a board or over a network, has nothing to compare.
    """

    watchdog: ClassVar[Watchdog] = Watchdog.NONE
    reads_back: ClassVar[bool] = True
    """Whether it measures currents; else `poll` has no readings, and nothing confirms a zero."""
    most_channels: ClassVar[int] = 16
    sample_s = 0.0008
    """How often it is given currents that turn: a little more than a thousand a second, fewer
    where its line would keep a queue."""
    can_swing: ClassVar[bool] = False
    """Whether there are devices that turn currents by themselves, as a `Swing` says."""
    swings = False
    """Whether this one does, from command to command."""
    clock = Clock()
    """Where this driver, and the `CoilDriver` around it, take time from."""
    open_port: Callable[..., Port] = Port
    """What opens a port; a test gives another."""
    adapter_at: Callable[[str], Adapter | None] = staticmethod(adapter_at)
    """What finds the USB adapter behind a port; a test gives another."""
    read_back_s = READ_BACK_S
    """How long this one waits for the read-back."""
    unreachable: tuple[str, ...] = ()
    """The ports that could not be reached since `connect` was called."""
    report_age_s = 0.0
    """How long before `Reading.since_s` [s] the currents may have been measured at most."""
    resolution_A = 0.0
    """The step in which the device reports currents."""

    def __init__(self, url: str, full_scale_A: float | Sequence[float],
                 channels: int = len(COILS)) -> None:
        if not 1 <= channels <= self.most_channels:
            raise InputError('amplifier', f'expected 1 to {self.most_channels} coils for '
                                          f'{type(self).__name__}; received {channels}')
        self.url = url
        self.urls: tuple[str, ...] = (url,)
        """The ports, one for each serial line."""
        self.channels = channels
        self.full_scale_A = np.broadcast_to(np.asarray(full_scale_A, float), channels).copy()
        if not np.all((self.full_scale_A > 0) & np.isfinite(self.full_scale_A)):
            raise InputError('full_scale_A', f'expected amperes above 0, got {full_scale_A}')
        self.counters = Counters()
        self.fault = ''
        """What the device said last is wrong with it; '' where it says nothing of the kind."""
        self._tolerance_A = _AGREEMENT * self.full_scale_A + self.resolution_A / 2
        self._unacknowledged: deque[Command] = deque(maxlen=64)
        self._last: Command | None = None
        self._sent_s = 0.0
        self._shown = False  # whether the newest reading shows no current
        self._lines: list[Port] = []
        self._woken = threading.Event()
        self._adapters: dict[str, Adapter] = {}
        self._found: dict[str, Adapter | None] = {}
        self._known = False  # connected before: a zero may go ahead of all questions

    @property
    def watchable(self) -> bool:
        """Whether a sentinel can hold all lines, judged by the names of the ports."""
        return all(has_descriptor(url) for url in self.urls)

    def connect(self) -> None:
        """Open, identify, arm the device's watchdog where it has one, zero and read back.

        Where the driver was connected before, a zero goes ahead of everything else. Raises an
        AmplifierError where any of it fails; whatever could be reached is at zero and switched
        off then, and every port given back.
        """
        if self._lines:
            self.close()
        self._unacknowledged.clear()
        self._last, self._shown = None, False
        self.fault, self.unreachable = '', ()
        try:
            with self._noting():
                self._open()
                self.zero()
                if self.reads_back:
                    self._await_zero()
        except BaseException as error:
            try:
                self._abort(error)
            finally:
                self._release()
            raise
        self._known = True
        self._adapters |= {url: found for url, found in self._found.items() if found is not None}

    def write(self, currents_A: Sequence[float] | np.ndarray, tag: Any = None,
              swing: Swing | None = None) -> Command:
        """Send `currents_A` (N,) [A], with a `tag`, in place of any that a slow line has yet to
        take; with a `swing` a device that `swings` goes on from there by itself.

        Zero goes out at once, ahead of all else. Raises ValueError, with nothing sent, for any
        that is not within the full scale (NaN is not), and AmplifierError where the line is lost.
        """
        currents = np.array(currents_A, dtype=float)
        shape = self.full_scale_A.shape
        largest = np.abs(currents) if swing is None else swing.largest
        if currents.shape != shape or not np.all(largest <= self.full_scale_A):
            raise ValueError(
                f'currents must be {self.channels} values within ±{self.full_scale_A} A; '
                f'received {currents_A}')
        command = Command(self.clock.now(), currents, tag, swing)
        self._unacknowledged.append(command)
        self._shown = self._shown and not np.any(largest)
        self._last, self._sent_s = command, command.t_monotonic_s
        with self._noting():
            self._send(command)
        return command

    def zero(self) -> Command:
        """Send zeros."""
        return self.write(np.zeros(self.channels))

    def poll(self, timeout_s: float = 0.0) -> list[Reading]:
        """The readings that arrived; waits at most `timeout_s` for the first. Moves no current
        but by what was written and has yet to go out on a slow line.

        Raises AmplifierError where a line is lost or a device silent, once a zero has been sent
        to all others.
        """
        with self._noting():
            readings = [self._reading(*measured) for measured in self._receive(timeout_s)]
            if readings:
                self._shown = self.shows_zero(readings[-1].currents_A)
            self._insist()
        return readings

    def _insist(self) -> None:
        """Send the last command again if it was a zero that no reading has shown."""
        last = self._last
        if (last is None or self._shown or not self.reads_back or np.any(last.currents_A)
                or self.clock.now() - self._sent_s < AGAIN_S):
            return
        self._sent_s = self.clock.now()
        self._send(last)

    def shows_zero(self, currents_A: np.ndarray) -> bool:
        """Return whether measured `currents_A` (N,) [A] agree with zero; NaN does not."""
        return bool(np.all(np.abs(currents_A) <= self._tolerance_A))

    def close(self) -> Zero:
        """Zero, read back, disable and release every port; return the worst that holds of a coil.

        Never raises an AmplifierError: each line is zeroed whatever becomes of the others, and
        those that cannot be reached are named in `unreachable`. Without a connection the result
        is UNREACHABLE.
        """
        if not self._lines:
            self.unreachable = self.unreachable or self.urls
            return Zero.UNREACHABLE
        try:
            return self._end()
        finally:
            self._release()

    def wake(self) -> None:
        """Let a `poll` that waits return at once; from any thread, whatever state it is in."""
        self._woken.set()
        for port in self._lines.copy():
            port.wake()

    def last_words(self) -> list[tuple[int, bytes]]:
        """What zeroes the coils when this process no longer can: for each line its descriptor and
        the bytes. Without those whose port has no descriptor: see `watchable`."""
        self._require_lines()
        return [(port.descriptor, zero) for port, zero
                in zip(self._lines, self._zeros(), strict=True) if port.descriptor is not None]

    def _end(self) -> Zero:
        """Zero, read back and disable; return the worst that holds of a coil."""
        try:
            self.zero()
            if self.reads_back:
                self._await_zero()
                return Zero.CONFIRMED
        except UnreachableError:
            return Zero.UNREACHABLE
        except NoAnswerError:
            pass
        return Zero.SENT

    def _abort(self, error: BaseException) -> None:
        """Zero and disable what was reached by a connection that failed, but no other device."""
        if not isinstance(error, WrongDeviceError):
            with suppress(AmplifierError):
                self.zero()

    def _await_zero(self) -> None:
        deadline = self.clock.now() + self.read_back_s
        while (left := deadline - self.clock.now()) > 0:
            if any(self.shows_zero(reading.currents_A)
                   for reading in self.poll(min(left, AGAIN_S))):
                return
        raise NoAnswerError(self.url, f'measured currents of zero within {self.read_back_s:g} s')

    def _open_port(self, url: str, baud: int, **options: Any) -> Port:
        """Open a port, unless another adapter than before is there."""
        found = self._found[url] = self.adapter_at(url)
        bound = self._adapters.get(url)
        if found is not None and not found.may_be_named(url):
            raise WrongDeviceError(url, 'the USB adapter that the port names', str(found))
        # Where there is nothing at all, opening says so.
        if bound not in (None, found) and (found is not None or Path(url).exists()):
            raise WrongDeviceError(url, f'the adapter {bound}',
                                   'a port that is not a USB '
                                   'adapter' if found is None else str(found))
        return self.open_port(url, baud, **options)

    def _lose(self, error: UnreachableError) -> None:
        self.unreachable = tuple(sorted({*self.unreachable, error.url}))

    @contextmanager
    def _noting(self) -> Iterator[None]:
        try:
            yield
        except UnreachableError as error:
            self._lose(error)
            raise

    def _require_lines(self) -> None:
        if not self._lines:
            raise NoAnswerError(self.url, 'a connection')

    def _release(self) -> None:
        """Close whatever `_open` opened; harmless when it is closed already."""
        while self._lines:
            self._lines.pop().close()

    def _reading(self, t_monotonic_s: float, since_s: float, currents: np.ndarray) -> Reading:
        for position, command in enumerate(self._unacknowledged):
            if np.all(np.abs(currents - command.currents_A) <= self._tolerance_A):
                for _ in range(position + 1):  # those before it were superseded
                    self._unacknowledged.popleft()
                return Reading(t_monotonic_s, since_s, currents, command)
        return Reading(t_monotonic_s, since_s, currents, None)

    @abstractmethod
    def _open(self) -> None:
        """Append the open ports to `_lines`, send a zero to a device that is known, make sure that
        the right one answers, and enable its outputs at zero."""

    @abstractmethod
    def _send(self, command: Command) -> None:
        """Send currents that are known to be within the full scale."""

    @abstractmethod
    def _receive(self, timeout_s: float) -> list[tuple[float, float, np.ndarray]]:
        """When they arrived, since when the device had what it had (`Reading.since_s`), and the
        measured currents, all finite."""

    @abstractmethod
    def _zeros(self) -> list[bytes]:
        """Return for each line what zeroes its coils in one go, whatever was said before."""


@functools.cache
def amplifier_class(protocol: str) -> type[Amplifier]:
    """The driver registered for `protocol` in the entry-point group `microbot_ros.amplifiers`.

    Raises InputError for a name that is not registered or whose driver does not load: there is
    no falling back to another.
    """
    driver: type[Amplifier] = installed('microbot_ros.amplifiers', 'amplifier', protocol)
    return driver
