"""The loop that serves an emulated amplifier behind its lines, with the faults it is to have."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from microbot_ros.common.errors import InputError
from microbot_ros.drive.emulator.device import Device
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.line import Line

_ABSENT_S = 0.01
"""While no host has a line open, how often to look whether one has (Linux gives no event)."""
_IDLE_S = 0.05


class DeviceEnd(Protocol):
    """The device's end of a serial line, of whatever kind."""

    def plug(self) -> None:
        """Make the line there to be opened; harmless the second time."""

    def unplug(self) -> None:
        """Hang up; harmless the second time."""

    def read(self) -> bytes:
        """Return the bytes that wait."""

    def write(self, data: bytes) -> None:
        """Send `data`; what no host is there to take is lost."""


class Emulation:
    """Moves bytes between hosts, on `lines`, and a `device` with `faults`, whenever it is stepped.

    `clock` returns the time [s] that the faults and the device's coils count in.
    """

    def __init__(self, device: Device, lines: Sequence[DeviceEnd], faults: Faults,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.device = device
        self.faults = faults
        self._lines = lines
        self._clock = clock
        self._late: list[tuple[float, int, bytes]] = []

    def step(self) -> None:
        """Do all that is due by now."""
        self._apply_faults(self._clock())
        for port, line in enumerate(self._lines):
            if data := line.read():
                now = self._clock()
                data = self.faults.damage(data, now, port)
                if self.faults.value('reset', now) is None:
                    self._send(port, self.device.receive(port, data, now), now)
        now = self._clock()
        self.device.coils.watch(now)
        if now >= self.device.due_s():
            self._send(0, self.device.speak(now), now)
        self._send_late(now)

    def due_s(self) -> float:
        """When there is something to do though no byte comes [s]; inf for never."""
        return min((self.device.due_s(), self.device.coils.due_s(),
                    self.faults.due_s(self._clock()), *(due for due, _, _ in self._late)))

    def _apply_faults(self, now_s: float) -> None:
        device, faults = self.device, self.faults
        if faults.reset_due(now_s):
            device.reset()
        device.wrong_ports = frozenset(
            port for port in range(device.ports)
            if faults.value('wrong_reply', now_s, port) is not None)
        device.hot = faults.value('over_temperature', now_s) is not None
        device.coils.conduct(*faults.conducted(now_s, device.coils.channels))
        for port, line in enumerate(self._lines):
            if faults.value('unplug', now_s, port) is not None:
                line.unplug()
            else:
                line.plug()

    def _send(self, port: int, data: bytes, now_s: float) -> None:
        if not data or any(self.faults.value(kind, now_s, port) is not None
                           for kind in ('silence', 'reset')):
            return
        data = self.faults.damage(data, now_s, port)
        delay_ms = self.faults.value('delay', now_s, port)
        if delay_ms is None and not any(late == port for _, late, _ in self._late):
            self._lines[port].write(data)
        else:
            self._late.append((now_s + (delay_ms or 0.0) * 1e-3, port, data))

    def _send_late(self, now_s: float) -> None:
        due = [entry for entry in self._late if entry[0] <= now_s]
        self._late = [entry for entry in self._late if entry[0] > now_s]
        for _, port, data in due:
            self._lines[port].write(data)


class Server:
    """Serves a device on pseudo-terminals in real time. `commands`, where there is one, is the
    descriptor of a stream on which faults come in, one a line, while it runs.
    """

    def __init__(self, device: Device, lines: list[Line], faults: Faults,
                 commands: int | None) -> None:
        self._emulation = Emulation(device, lines, faults)
        self._lines = lines
        self._commands = commands
        self._unfinished = b''

    def run(self, stopping: Callable[[], bool]) -> None:
        """Serve until `stopping()`, asked at least every 50 ms."""
        while not stopping():
            self._wait()
            self._emulation.step()

    def _wait(self) -> None:
        """Sleep until a byte comes or something is due.

        Absent hosts are not waited for: a line that has hung up is always ready, so only its
        absence is, and that is looked at now and then.
        """
        ready = [line.master for line in self._lines if line.present and line.master is not None]
        idle = _IDLE_S if len(ready) == len(self._lines) else _ABSENT_S
        timeout = min(max(self._emulation.due_s() - time.monotonic(), 0.0), idle)
        commands = [] if self._commands is None else [self._commands]
        for stream in select.select(ready + commands, [], [], timeout)[0]:
            if stream == self._commands:
                self._take_commands(stream)

    def _take_commands(self, stream: int) -> None:
        data = os.read(stream, 4096)
        if not data:
            self._commands = None
        *lines, self._unfinished = (self._unfinished + data).split(b'\n')
        for line in lines:
            try:
                self._emulation.faults.add(parse(line.decode(errors='replace'), time.monotonic()))
            except InputError as error:
                print(f'microbot: {error}', file=sys.stderr, flush=True)
