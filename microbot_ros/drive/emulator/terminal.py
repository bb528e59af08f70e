"""Pseudo-terminals with an emulated amplifier behind them, served by one loop of `poll`."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import time
import tty
from collections.abc import Callable
from pathlib import Path

from microbot_ros.drive.emulator.device import Device
from microbot_ros.errors import InputError

_ABSENT_S = 0.01
"""While no host has a line open, how often to look whether one has (Linux gives no event)."""
_IDLE_S = 0.05


class Line:
    """One pseudo-terminal under a name that a host can open, again and again."""

    def __init__(self, link: Path) -> None:
        self.link = link
        if link.exists() and not link.is_symlink():
            raise InputError(link, 'expected a name that is free for the link, found a file')
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.device = os.ttyname(slave)
        os.close(slave)  # from here `poll` reports a hang-up until a host opens the line
        os.set_blocking(self.master, False)
        self.present = False
        """Whether a host has the line open, as far as the last look told."""
        link.unlink(missing_ok=True)
        try:
            link.symlink_to(self.device)
        except OSError as error:
            os.close(self.master)
            raise InputError(link, f'expected a place to link from ({error.strerror})') from None

    def look(self) -> None:
        """See whether a host has opened the line or left it."""
        poller = select.poll()
        poller.register(self.master, select.POLLIN)
        self.present = not any(event & select.POLLHUP for _, event in poller.poll(0))

    def read(self) -> bytes:
        """The bytes that wait; b'' where there are none or the host has gone."""
        try:
            return os.read(self.master, 65536)
        except OSError:
            return b''

    def write(self, data: bytes) -> None:
        """Send; what a host does not take is lost, as on a wire."""
        with contextlib.suppress(OSError):
            os.write(self.master, data)

    def close(self) -> None:
        """Hang up and remove the link, if it is still this line's."""
        if self.link.is_symlink() and os.readlink(self.link) == self.device:
            self.link.unlink()
        os.close(self.master)


def serve(device: Device, lines: list[Line], stopping: Callable[[], bool]) -> None:
    """Serve the device behind its lines until `stopping()`, asked at least every 50 ms."""
    while not stopping():
        _wait(device, lines)
        for number, line in enumerate(lines):
            line.look()
            if data := line.read():
                line.write(device.receive(number, data, time.monotonic()))
        now = time.monotonic()
        device.coils.watch(now)
        if now >= device.due_s():
            said = device.speak(now)
            if lines[0].present:
                lines[0].write(said)


def _wait(device: Device, lines: list[Line]) -> None:
    """Sleep until a byte comes or something is due. Absent hosts are not waited for: a line that
    has hung up is always ready, so only its absence is, and that is looked at now and then.
    """
    present = [line.master for line in lines if line.present]
    idle = _IDLE_S if len(present) == len(lines) else _ABSENT_S
    due = min(device.due_s(), device.coils.due_s()) - time.monotonic()
    select.select(present, [], [], min(max(due, 0.0), idle))
