"""Base of all amplifier drivers: it sends currents and receives measured ones, one per coil.

Four coils in the plane are in the order +Y, +X, −Y, −X. A driver changes currents in `write` and
`zero` only. It enforces no limit but its full scale; all other limits belong to the gate.
"""

from __future__ import annotations

import functools
import math
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
from microbot_ros.common.extras import installed
from microbot_ros.common.patience import PATIENCE
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

AGAIN_S = 0.01
"""Interval [s] at which a zero that no reading has shown is sent again, as the line may have
damaged it. A line that damages every other packet then lets one through within 0.1 s in all but
one of 1000 cases."""

_AGREEMENT = 0.02
"""Largest deviation of a reading from the command that it acknowledges, as a part of full scale.
Choice: half would leave commands unacknowledged on a noisy sense line, twice would confuse
commands that differ little."""


class Watchdog(StrEnum):
    """Mechanism that zeroes the coils when this computer fails."""

    ARMED = 'set in the device and read back'
    FIRMWARE = 'in the firmware, if it has one: arming tests it'
    UNCONFIRMED = 'set in the device, which does not confirm it'
    NONE = 'none'


class Zero(StrEnum):
    """State of a requested zero; each value is the text for people."""

    CONFIRMED = 'zero, confirmed by a reading'
    SENT = 'zero sent, not confirmed'
    UNREACHABLE = 'not reachable'


BY_HAND = 'switch the amplifier off by hand'
"""Instruction to people if coils cannot be reached."""


@dataclass(frozen=True, eq=False)
class Swing:
    """Currents of a rotating field: `steady` + `cosine` cos ωt + `sine` sin ωt.

    Each is (N,) [A], with ω the `rate` [rad/s] and t [s] the time since they were sent.
    """

    steady: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    rate: float

    @property
    def largest(self) -> np.ndarray:
        """Largest magnitude that each current reaches (N,) [A]."""
        return np.asarray(np.abs(self.steady) + self.amplitude)

    @property
    def amplitude(self) -> np.ndarray:
        """Amplitude of the oscillating part of each current (N,) [A]."""
        return np.hypot(self.cosine, self.sine)


@dataclass(frozen=True, eq=False)
class Command:
    """Currents that were handed to the line.

    Attributes
    ----------
    t_monotonic_s : float
        Time [s] of the monotonic clock at which they were handed over.
    currents_A : ndarray, shape (N,)
        Current of each coil [A].
    tag : object
        Identification given by the caller.
    swing : Swing or None
        How a device continues the currents by itself; None if it does not.
    """

    t_monotonic_s: float
    currents_A: np.ndarray
    tag: Any = None
    swing: Swing | None = None


@dataclass(frozen=True, eq=False)
class Reading:
    """Measured currents.

    Attributes
    ----------
    t_monotonic_s : float
        Time [s] of the monotonic clock at which they arrived.
    since_s : float
        Time [s] at which the last command was sent that the device certainly had when it measured.
        Every later command may or may not be visible in the reading.
    currents_A : ndarray, shape (N,)
        Measured current of each coil [A].
    acknowledges : Command or None
        Oldest command that agrees with these currents and that no earlier reading acknowledged;
        None if there is none.
    """

    t_monotonic_s: float
    since_s: float
    currents_A: np.ndarray
    acknowledges: Command | None


@dataclass
class Counters:
    """Traffic since the driver was created.

    Attributes
    ----------
    frames_sent : int
        Commands sent.
    frames_received : int
        Readings received.
    crc_errors : int
        Answers whose checksum was wrong.
    discarded_bytes : int
        Bytes that belonged to no answer.
    """

    frames_sent: int = 0
    frames_received: int = 0
    crc_errors: int = 0
    discarded_bytes: int = 0


class Amplifier(ABC):
    """Current source with one channel for each of N coils, behind one protocol.

    All methods are called by one thread, except `wake`, which any thread may call.

    A driver is bound to the USB adapters of its first connection. If another adapter is found at a
    port later, or if a name under `/dev/serial/by-id/` is not that of the adapter, nothing is
    sent. A port without USB identity, on the board or over a network, is not compared.

    Parameters
    ----------
    url : str
        Name of the port; for a protocol with several ports all names, separated by commas.
    full_scale_A : float or sequence of float
        Current of each coil at full output [A]; a scalar applies to all coils.
    channels : int
        Number of coils N.

    Raises
    ------
    InputError
        If there are more channels than `most_channels`, or if a full scale is not finite and above
        0.
    """

    watchdog: ClassVar[Watchdog] = Watchdog.NONE
    reads_back: ClassVar[bool] = True
    """Whether it measures currents. Otherwise `poll` returns no readings and nothing confirms a
    zero."""
    most_channels: ClassVar[int] = 16
    """Largest number of coils. Choice: the range of the project, 2 to 16; drivers lower it to the
    limit of their protocol."""
    sample_s = 0.0008
    """Interval [s] between samples of rotating currents. Choice: a little more than a thousand a
    second, as often as the reference firmware steps; longer where the line would build up a
    queue."""
    can_swing: ClassVar[bool] = False
    """Whether some devices of this protocol rotate currents by themselves as a `Swing`
    describes."""
    swings = False
    """Whether the connected device does so between commands."""
    clock = Clock()
    """Clock of this driver and of the `CoilDriver` around it."""
    open_port: Callable[..., Port] = Port
    """Function that opens a port; tests replace it."""
    adapter_at: Callable[[str], Adapter | None] = staticmethod(adapter_at)
    """Function that finds the USB adapter behind a port; tests replace it."""
    unreachable: tuple[str, ...] = ()
    """Ports that could not be reached since `connect` was called."""
    report_age_s = 0.0
    """Longest time [s] before `Reading.since_s` at which the currents may have been measured; 0
    for devices that measure on request."""
    resolution_A = 0.0
    """Step [A] in which the device reports currents; 0 where the step is negligible."""

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
            raise InputError('full_scale_A', f'expected amperes above 0; received {full_scale_A}')
        self.counters = Counters()
        self.fault = ''
        """Fault that the device reported last; '' for none."""
        self._tolerance_A = _AGREEMENT * self.full_scale_A + self.resolution_A / 2
        self._unacknowledged: deque[Command] = deque(maxlen=64)
        self._last: Command | None = None
        self._sent_s = 0.0
        self._shown = False  # whether the newest reading of after the zero shows no current
        self._zeroed_s = math.inf  # when the zero was first sent that is in force
        self._lines: list[Port] = []
        self._woken = threading.Event()
        self._adapters: dict[str, Adapter] = {}
        self._found: dict[str, Adapter | None] = {}
        self._known = False  # connected before: a zero may precede the identification

    @property
    def watchable(self) -> bool:
        """Whether a sentinel can hold all lines, judged by the names of the ports."""
        return all(has_descriptor(url) for url in self.urls)

    def connect(self) -> None:
        """Open the ports, identify the device, arm its watchdog if any, zero it and read back.

        If the driver was connected before, a zero is sent before everything else.

        Raises
        ------
        AmplifierError
            If any step fails. All devices that could be reached are then at zero and switched off,
            and every port is released.
        """
        if self._lines:
            self.close()
        self._unacknowledged.clear()
        self._last, self._shown, self._zeroed_s = None, False, math.inf
        self.fault, self.unreachable = '', ()
        try:
            with self._noting():
                self._open()
                zero = self.zero()
                if self.reads_back:
                    self._await(zero)
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
        """Send currents, in place of any that a slow line has not transmitted yet.

        Zero is sent at once, before everything else.

        Parameters
        ----------
        currents_A : sequence of float or ndarray, shape (N,)
            Current of each coil [A].
        tag : object
            Identification of the command, returned with it unchanged.
        swing : Swing or None
            Given to a device that `swings`: it continues from these currents by itself.

        Returns
        -------
        Command
            The command that was sent.

        Raises
        ------
        ValueError
            If a current is not within the full scale (NaN is not). Nothing is sent.
        AmplifierError
            If the line is lost.
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
        if np.any(largest):
            self._shown, self._zeroed_s = False, math.inf
        else:
            self._zeroed_s = min(self._zeroed_s, command.t_monotonic_s)
        self._last, self._sent_s = command, command.t_monotonic_s
        with self._noting():
            self._send(command)
        return command

    def zero(self) -> Command:
        """Send zeros.

        Returns
        -------
        Command
            The command that was sent.
        """
        return self.write(np.zeros(self.channels))

    def poll(self, timeout_s: float = 0.0) -> list[Reading]:
        """Return the readings that arrived; wait for the first if there is none.

        It changes no current, except that commands written before may still have to go out on a
        slow line.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait [s].

        Returns
        -------
        list of Reading
            Readings in the order of arrival; empty if none arrived.

        Raises
        ------
        AmplifierError
            If a line is lost or a device is silent, after a zero was sent to all others.
        """
        with self._noting():
            readings = [self._reading(*measured) for measured in self._receive(timeout_s)]
            if readings:
                last = readings[-1]
                self._shown = self.shows_zero(last.currents_A) and (
                    self._shown or last.since_s - self.report_age_s >= self._zeroed_s)
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
        """Return whether measured currents agree with zero.

        Parameters
        ----------
        currents_A : ndarray, shape (N,)
            Current of each coil [A].

        Returns
        -------
        bool
            False also if a current is NaN.
        """
        return bool(np.all(np.abs(currents_A) <= self._tolerance_A))

    def close(self) -> Zero:
        """Zero, read back, disable and release every port.

        It never raises an AmplifierError: each line is zeroed whatever happens to the others, and
        lines that cannot be reached are listed in `unreachable`.

        Returns
        -------
        Zero
            The worst state of any coil; UNREACHABLE without a connection.
        """
        if not self._lines:
            self.unreachable = self.unreachable or self.urls
            return Zero.UNREACHABLE
        try:
            return self._end()
        finally:
            self._release()

    def wake(self) -> None:
        """Make a waiting `poll` return at once; callable from any thread in any state."""
        self._woken.set()
        for port in self._lines.copy():
            port.wake()

    def last_words(self) -> list[tuple[int, bytes]]:
        """Return the bytes that zero the coils when this process no longer can.

        Returns
        -------
        list of tuple[int, bytes]
            Descriptor and bytes of each line, without lines whose port has no descriptor; see
            `watchable`.

        Raises
        ------
        NoAnswerError
            Without a connection.
        """
        self._require_lines()
        return [(port.descriptor, zero) for port, zero
                in zip(self._lines, self._zeros(), strict=True) if port.descriptor is not None]

    def _end(self) -> Zero:
        """Zero, read back and disable; return the worst state of any coil."""
        try:
            zero = self.zero()
            if self.reads_back:
                self._await(zero)
                return Zero.CONFIRMED
        except UnreachableError:
            return Zero.UNREACHABLE
        except NoAnswerError:
            pass
        return Zero.SENT

    def _abort(self, error: BaseException) -> None:
        """Zero and disable the devices that a failed connection reached, but no wrong device."""
        if not isinstance(error, WrongDeviceError):
            with suppress(AmplifierError):
                self.zero()

    def _await(self, zero: Command) -> None:
        """Wait for a reading that was taken after a zero was sent, and shows it.

        What waits on the line may be older than its arrival here tells.
        """
        deadline, drained_s = self.clock.now() + PATIENCE.read_back_s, -math.inf
        while (left := deadline - self.clock.now()) > 0:
            readings = self.poll(0.0)
            if not readings:
                drained_s = self.clock.now()
                readings = self.poll(min(left, AGAIN_S))
            if any(min(reading.since_s, drained_s) - self.report_age_s >= zero.t_monotonic_s
                   and self.shows_zero(reading.currents_A) for reading in readings):
                return
        raise NoAnswerError(
            self.url, f'measured currents of zero within {PATIENCE.read_back_s:g} s')

    def _open_port(self, url: str, baud: int, **options: Any) -> Port:
        """Open a port, unless another adapter than before is there."""
        found = self._found[url] = self.adapter_at(url)
        bound = self._adapters.get(url)
        if found is not None and not found.may_be_named(url):
            raise WrongDeviceError(url, 'the USB adapter that the port names', str(found))
        # If there is no port at all, opening reports it.
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
        """Close all ports that `_open` opened; does nothing if they are closed."""
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
        """Append the open ports to `_lines`, identify the device and enable its outputs at zero.

        A device that was connected before is sent a zero first.
        """

    @abstractmethod
    def _send(self, command: Command) -> None:
        """Send currents that are known to be within the full scale."""

    @abstractmethod
    def _receive(self, timeout_s: float) -> list[tuple[float, float, np.ndarray]]:
        """Return time of arrival, `Reading.since_s` and finite currents of each reading."""

    @abstractmethod
    def _zeros(self) -> list[bytes]:
        """Return for each line the bytes that zero its coils at once, whatever was sent before."""


@functools.cache
def amplifier_class(protocol: str) -> type[Amplifier]:
    """Return the driver registered in the entry-point group `microbot_ros.amplifiers`.

    Parameters
    ----------
    protocol : str
        Name of the protocol.

    Returns
    -------
    type[Amplifier]
        Class of the driver.

    Raises
    ------
    InputError
        If the name is not registered or its driver does not load; there is no fallback.
    """
    driver: type[Amplifier] = installed('microbot_ros.amplifiers', 'amplifier', protocol)
    return driver
