"""The loop that serves an emulated amplifier behind its lines, with the faults it is to have."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable

from microbot_ros.drive.emulator.device import Device
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.line import Line
from microbot_ros.errors import InputError

_ABSENT_S = 0.01
"""While no host has a line open, how often to look whether one has (Linux gives no event)."""
_IDLE_S = 0.05


class Server:
    """Moves bytes between hosts, on `lines`, and a device. `commands`, where there is one, is the
    descriptor of a stream on which faults come in, one a line, while it runs.
    """

    def __init__(self, device: Device, lines: list[Line], faults: Faults,
                 commands: int | None) -> None:
        self._device = device
        self._lines = lines
        self._faults = faults
        self._commands = commands
        self._unfinished = b''
        self._late: list[tuple[float, Line, bytes]] = []

    def run(self, stopping: Callable[[], bool]) -> None:
        """Serve until `stopping()`, asked at least every 50 ms."""
        while not stopping():
            self._wait()
            self._apply_faults(time.monotonic())
            for number, line in enumerate(self._lines):
                if data := line.read():
                    now = time.monotonic()
                    data = self._faults.damage(data, now)
                    if self._faults.value('reset', now) is None:
                        self._send(line, self._device.receive(number, data, now), now)
            now = time.monotonic()
            self._device.coils.watch(now)
            if now >= self._device.due_s():
                self._send(self._lines[0], self._device.speak(now), now)
            self._send_late(now)

    def _wait(self) -> None:
        """Sleep until a byte comes or something is due.

        Absent hosts are not waited for: a line that has hung up is always ready, so only its
        absence is, and that is looked at now and then.
        """
        ready = [line.master for line in self._lines if line.present and line.master is not None]
        idle = _IDLE_S if len(ready) == len(self._lines) else _ABSENT_S
        due = min((self._device.due_s(), self._device.coils.due_s(),
                   *(due for due, _, _ in self._late)))
        timeout = min(max(due - time.monotonic(), 0.0), idle)
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
                self._faults.add(parse(line.decode(errors='replace'), time.monotonic()))
            except InputError as error:
                print(f'microbot: {error}', file=sys.stderr, flush=True)

    def _apply_faults(self, now_s: float) -> None:
        device, faults = self._device, self._faults
        if faults.reset_due(now_s):
            device.reset()
        device.wrong_device = faults.value('wrong_reply', now_s) is not None
        device.hot = faults.value('over_temperature', now_s) is not None
        device.coils.conduct(*faults.conducted(now_s, device.coils.channels))
        unplugged = faults.value('unplug', now_s) is not None
        for line in self._lines:
            if unplugged:
                line.unplug()
            elif line.master is None:
                line.plug()

    def _send(self, line: Line, data: bytes, now_s: float) -> None:
        if not data or any(self._faults.value(kind, now_s) is not None
                           for kind in ('silence', 'reset')):
            return
        data = self._faults.damage(data, now_s)
        delay_ms = self._faults.value('delay', now_s)
        if delay_ms is None and not self._late:
            line.write(data)
        else:
            self._late.append((now_s + (delay_ms or 0.0) * 1e-3, line, data))

    def _send_late(self, now_s: float) -> None:
        while self._late and self._late[0][0] <= now_s:
            _, line, data = self._late.pop(0)
            line.write(data)
