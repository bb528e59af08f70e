"""Loop that serves an emulated amplifier behind its lines, with its faults."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable, Sequence

from microbot_ros.common.errors import InputError
from microbot_ros.drive.emulator.device import Device
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.line import Line

_ABSENT_S = 0.01
"""Interval [s] at which a line without host is checked for one (Linux gives no event). Choice: it
delays the first answer by as much."""
_IDLE_S = 0.05
"""Longest wait [s] without an event. Choice: the end of the process is noticed within it."""


class Emulation:
    """Transfer of bytes between hosts and a device with faults, step by step.

    Parameters
    ----------
    device : Device
        The device.
    lines : sequence of Line
        Its lines.
    faults : Faults
        Its faults.
    clock : callable
        Function that returns the time [s] of the faults and of the device's coils.
    """

    def __init__(self, device: Device, lines: Sequence[Line], faults: Faults,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.device = device
        self.faults = faults
        self._lines = lines
        self._clock = clock
        self._late: list[tuple[float, int, bytes]] = []

    def step(self) -> None:
        """Do everything that is due by now."""
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
        """Return the time at which there is something to do even if no byte arrives.

        Returns
        -------
        float
            Time [s]; inf for never.
        """
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
    """Server of a device on pseudo-terminals in real time.

    Parameters
    ----------
    device : Device
        The device.
    lines : list of Line
        Its lines.
    faults : Faults
        Its faults.
    commands : int or None
        Descriptor of a stream on which faults arrive while it runs, one per line; None for none.
    """

    def __init__(self, device: Device, lines: list[Line], faults: Faults,
                 commands: int | None) -> None:
        self._emulation = Emulation(device, lines, faults)
        self._lines = lines
        self._commands = commands
        self._unfinished = b''

    def run(self, stopping: Callable[[], bool]) -> None:
        """Serve until told to stop.

        Parameters
        ----------
        stopping : callable
            Called at least every 50 ms; True stops.
        """
        while not stopping():
            self._wait()
            self._emulation.step()

    def _wait(self) -> None:
        """Sleep until a byte arrives or something is due.

        A line that has hung up is always ready, so it is not waited for but checked at intervals.
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
