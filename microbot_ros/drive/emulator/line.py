"""A pseudo-terminal under a name that a host can open, leave and open again."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import tty
from pathlib import Path

from microbot_ros.common.errors import InputError


class Line:
    """One end of a serial line; the host opens the other under the name `link`.

    Raises InputError where the link cannot be made.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.present = False
        """Whether a host has the line open, as far as the last look told."""
        self._device = ''
        self.master: int | None = None
        if link.exists() and not link.is_symlink():
            raise InputError(link, 'expected an unused path for the link, found a file')
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether there is a line to open."""
        return self.master is not None

    def plug(self) -> None:
        """Make the line there to be opened; harmless the second time."""
        if self.plugged:
            return
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self._device = os.ttyname(slave)
        os.close(slave)  # from here `poll` reports a hang-up until a host opens the line
        os.set_blocking(self.master, False)
        self.link.unlink(missing_ok=True)
        try:
            self.link.symlink_to(self._device)
        except OSError as error:
            self.unplug()
            problem = f'expected a folder in which a link can be made ({error.strerror})'
            raise InputError(self.link, problem) from None

    def unplug(self) -> None:
        """Hang up and remove the link, if it is still this line's; harmless the second time."""
        if self.master is None:
            return
        if self.link.is_symlink() and os.readlink(self.link) == self._device:
            self.link.unlink()
        os.close(self.master)
        self.master, self.present = None, False

    def read(self) -> bytes:
        """The bytes that wait, and b'' where there are none; looks whether a host is there."""
        if self.master is None:
            return b''
        poller = select.poll()
        poller.register(self.master, select.POLLIN)
        event = sum(event for _, event in poller.poll(0))
        self.present = not event & select.POLLHUP
        try:
            return os.read(self.master, 65536) if event & select.POLLIN else b''
        except OSError:
            return b''

    def write(self, data: bytes) -> None:
        """Send `data`; what a host does not take, or is not there to take, is lost as on a wire.
        """
        if self.master is not None and self.present:
            with contextlib.suppress(OSError):
                os.write(self.master, data)
