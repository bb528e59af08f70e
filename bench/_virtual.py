"""Emulated amplifiers on virtual time, with their lines in memory: all in the caller's thread.

Time passes only while the driver waits, and then straight to the next moment at which something
is due, so that a test is exact to the microsecond and takes no time of its own.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Sequence
from typing import Any, TextIO, cast

import numpy as np

from microbot_ros.drive.amplifier import Amplifier, Reading, Zero, amplifier_class
from microbot_ros.drive.clock import Clock
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.process import make_device
from microbot_ros.drive.emulator.server import Emulation
from microbot_ros.drive.errors import PortBusyError, PortLostError, PortMissingError
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.transport import Port

_START_S = 1000.0
_STALLED = 10_000
"""So many looks at the clock without a wait between them are a driver that waits in a circle."""


class VirtualClock(Clock):
    """A clock that goes on only while somebody waits, and does then what is due on the way."""

    def __init__(self) -> None:
        self.now_s = _START_S
        self._emulations: list[Emulation] = []
        self._planned: list[tuple[float, Callable[[], None]]] = []
        self._looks = 0

    def now(self) -> float:
        self._looks += 1
        assert self._looks < _STALLED, 'the clock is looked at again and again without a wait'
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.wait_for(lambda: False, seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        return self.wait_for(event.is_set, seconds)

    def serve(self, emulation: Emulation) -> None:
        """Step an `emulation` whenever something is due in it."""
        self._emulations.append(emulation)

    def plan(self, after_s: float, do: Callable[[], None]) -> None:
        """Let something happen `after_s` [s] from now, as another thread would do it."""
        self._planned.append((self.now_s + after_s, do))

    def wait_for(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Let time pass until a `condition` holds, `seconds` at most; return whether it holds."""
        until_s = self.now_s + max(seconds, 0.0)
        while True:
            self._do_what_is_due()
            if condition() or self.now_s >= until_s:
                return condition()
            self._looks = 0
            due_s = min((*(emulation.due_s() for emulation in self._emulations),
                         *(at_s for at_s, _ in self._planned)), default=math.inf)
            # What is due and not done, as a device does that is behind, is so a microsecond later.
            self.now_s = min(max(due_s, self.now_s + 1e-6), until_s)

    def _do_what_is_due(self) -> None:
        for entry in [entry for entry in self._planned if entry[0] <= self.now_s]:
            self._planned.remove(entry)
            entry[1]()
        for emulation in self._emulations:
            emulation.step()


class MemoryLine:
    """A serial line in memory: the device's end, of which `open` makes the host's."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.host: MemoryPort | None = None
        self.sent: list[tuple[float, bytes]] = []
        """What the host sent, and when [s]."""
        self.takes = True
        """Whether it takes bytes; else `send` fails, as on a line that is blocked."""
        self._plugged = True
        self._to_device = b''

    def plug(self) -> None:
        """Make the line there to be opened."""
        self._plugged = True

    def unplug(self) -> None:
        """Hang up: the host's end is lost."""
        self._plugged, self._to_device = False, b''
        if self.host is not None:
            self.host.lost = True

    def read(self) -> bytes:
        """Return what the host has sent since the last look."""
        data, self._to_device = self._to_device, b''
        return data

    def write(self, data: bytes) -> None:
        """Send `data` to the host, where there is one."""
        if self.host is not None and not self.host.lost:
            self.host.arrived += data

    def take(self, data: bytes) -> None:
        """Take `data` from the host."""
        self.sent.append((self.clock.now_s, data))
        self._to_device += data

    def open(self, url: str) -> MemoryPort:
        """Return the host's end, which is called `url`. Raises PortMissingError or PortBusyError.
        """
        if not self._plugged:
            raise PortMissingError(url, 'unplugged')
        if self.host is not None:
            raise PortBusyError(url)
        self.host = MemoryPort(url, self)
        return self.host


class MemoryPort(Port):
    """The host's end of a `line` in memory, called `url` and used as a `transport.Port` is."""

    descriptor = None

    def __init__(self, url: str, line: MemoryLine) -> None:
        self.url, self.low_latency = url, True
        self.arrived = b''
        self.lost = False
        self._line = line
        self._woken = False

    def send(self, data: bytes) -> None:
        """Hand `data` to the line at once."""
        self._require()
        if not self._line.takes:
            raise PortLostError(self.url, 'it takes no bytes')
        self._line.take(data)
        self._line.clock.wait_for(lambda: True, 0.0)

    def receive(self, timeout_s: float = 0.0) -> bytes:
        """What has arrived; waits for the first byte at most `timeout_s`, or until woken."""
        self._line.clock.wait_for(
            lambda: bool(self.arrived) or self._woken or self.lost, timeout_s)
        self._require()
        self._woken = False
        data, self.arrived = self.arrived, b''
        return data

    def wake(self) -> None:
        """Let a `receive` that waits, or else the next one, return without waiting."""
        self._woken = True

    def discard_output(self) -> None:
        """Nothing waits: what is sent is there at once."""
        self._require()

    def discard_input(self) -> None:
        """Forget what arrived and was not read."""
        self._require()
        self.arrived = b''

    def close(self) -> None:
        """Give the line back."""
        self.lost = True
        if self._line.host is self:
            self._line.host = None

    def _require(self) -> None:
        if self.lost:
            raise PortLostError(self.url, 'unplugged')


class VirtualAmplifier:
    """An emulated amplifier of a `protocol` on virtual time, its faults and what flowed in it.

    `amplifier()` makes drivers that reach it. `channels` coils of ± `full_scale_A` [A]; the
    firmware's watchdog zeroes them after `watchdog_s` [s], None for never.
    """

    def __init__(self, protocol: str, *, channels: int = 4, full_scale_A: float = 2.0,
                 watchdog_s: float | None = 0.1, clock: VirtualClock | None = None) -> None:
        self.protocol, self.full_scale_A = protocol, full_scale_A
        self.clock = clock or VirtualClock()
        self.flowed: list[tuple[float, ...]] = []
        self.causes: list[str] = []
        self.times: list[float] = []
        self.coils = Coils(full_scale_A, watchdog_s, cast(TextIO, self),
                           lambda: self.clock.now_s, channels)
        self.device = make_device(protocol, self.coils)
        self.lines = [MemoryLine(self.clock) for _ in range(self.device.ports)]
        self.faults = Faults([])
        self.opened: list[tuple[str, int, bool]] = []
        """Url, baud rate and flow control of each port that was opened."""
        self.urls = [f'{protocol}-{number}' for number in range(1, self.device.ports + 1)]
        self.url = ','.join(self.urls)
        self.clock.serve(Emulation(self.device, self.lines, self.faults, lambda: self.clock.now_s))

    def amplifier(self) -> Amplifier:
        """Return a driver that is not connected yet."""
        made = amplifier_class(self.protocol)(self.url, self.full_scale_A, self.coils.channels)
        made.clock = self.clock
        made.open_port = self._open
        made.adapter_at = lambda _: None
        return made

    def _open(self, url: str, baud: int, *, xon_xoff: bool = False) -> MemoryPort:
        self.clock.wait_for(lambda: True, 0.0)
        self.opened.append((url, baud, xon_xoff))
        return self.lines[self.urls.index(url)].open(url)

    def write(self, line: str) -> None:
        """Take a line of the coils' log."""
        entry = json.loads(line)
        self.flowed.append(tuple(entry['currents_A']))
        self.causes.append(entry['cause'])
        self.times.append(entry['t_monotonic_s'])

    def flush(self) -> None:
        """Nothing waits."""

    def energise(self, currents_A: Sequence[float]) -> None:
        """Let a driver that is killed leave `currents_A` flowing, and no watchdog end them."""
        self.coils.feed = lambda: None  # type: ignore[method-assign]
        driver = self.amplifier()
        driver.connect()
        driver.write(currents_A)
        self.clock.wait_for(lambda: bool(driver.poll(0.01)) and self.flows(currents_A), 1.0)
        driver._release()

    def mute(self, address: int) -> None:
        """Let the device at an `address`, one of several on a line, obey and answer nothing."""
        receive = self.device.receive

        def answer(port: int, data: bytes, now_s: float) -> bytes:
            answered = receive(port, data, now_s)
            return b'' if data[0] == address else answered

        self.device.receive = answer  # type: ignore[method-assign]

    def fault(self, text: str) -> None:
        """Let a fault happen from now on; `text` describes it as `parse` reads it."""
        self.faults.add(parse(text, self.clock.now_s))

    def mend(self) -> None:
        """End all faults."""
        self.faults.clear()

    def flows(self, currents_A: Sequence[float]) -> bool:
        """Whether these `currents_A` flow, to within the steps of all protocols."""
        self.clock.wait_for(lambda: True, 0.0)
        return bool(np.allclose(self.coils.currents_A, currents_A, rtol=0,
                                atol=0.011 * self.full_scale_A))


class VirtualDriver:
    """A `CoilDriver` at an emulated `device`, stepped in the caller's thread.

    `limits`, `on_reading` and `options` are those of the driver.
    """

    def __init__(self, device: VirtualAmplifier, limits: Limits,
                 on_reading: Callable[[Reading], None] = lambda _: None, **options: Any) -> None:
        self.device, self.clock = device, device.clock
        self.driver = CoilDriver(device.amplifier(), limits, on_reading, **options)
        self.gate = self.driver.gate

    def connect(self) -> None:
        """Connect, as `CoilDriver.start` does."""
        self.driver._connect()

    def until(self, condition: Callable[[], Any], seconds: float = 30.0) -> Any:
        """Let the driver turn until a `condition` gives something true, and return that.

        AssertionError after so many `seconds`.
        """
        end_s = self.clock.now_s + seconds
        while not (value := condition()):
            assert self.clock.now_s < end_s, 'the awaited condition never came true'
            before_s = self.clock.now_s
            self.driver._turn()
            if self.clock.now_s == before_s:
                self.clock.sleep(1e-5)  # what a turn takes
        return value

    def turn(self, seconds: float) -> None:
        """Let the driver turn for so many seconds."""
        end_s = self.clock.now_s + seconds
        self.until(lambda: self.clock.now_s >= end_s, seconds + 30.0)

    def ask(self, epoch: int | None = None) -> str | None:
        """Return the answer to a request to arm, asked in an `epoch`; None for the present one."""
        answer = self.driver.request_arming(self.driver.epoch if epoch is None else epoch)
        self.until(answer.done)
        return answer.result()

    def arm(self) -> None:
        """Arm as soon as it is possible, and begin from zero."""
        self.until(lambda: self.ask() is None)
        self.driver.command([0.0] * self.device.coils.channels)

    def drive(self, currents_A: Sequence[float]) -> None:
        """Arm, command `currents_A` [A] once and wait until they flow."""
        self.arm()
        assert self.driver.command(currents_A)
        self.until(lambda: self.device.flows(currents_A))

    def stop(self) -> Zero:
        """End as `CoilDriver.stop` does; what is known of the zero."""
        self.driver._finish()
        return self.driver._left
