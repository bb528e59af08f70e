"""Pseudo-terminal under a name that a host can open, close and open again."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import tty
from pathlib import Path

from microbot_ros.common.errors import InputError

_TERMINALS = Path('/dev/pts')
"""Folder of pseudo-terminals. A link to one is what an emulator that was killed leaves."""


class Line:
    """Device end of a serial line; the host opens the other end under the name `link`.

    Parameters
    ----------
    link : Path
        Path of the link.

    Raises
    ------
    InputError
        If the link cannot be made.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.present = False
        """Whether a host has the line open, as of the last `read`."""
        self._device = ''
        self.master: int | None = None
        if link.exists() and not (
                link.is_symlink() and Path(os.readlink(link)).parent == _TERMINALS):
            raise InputError(link, 'expected an unused path for the link, found a file or the '
                                   'link to a device')
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether there is a line to open."""
        return self.master is not None

    def plug(self) -> None:
        """Create the line; does nothing if it exists.

        Raises
        ------
        InputError
            If the link cannot be made.
        """
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
        """Hang up and remove the link if it is still this line's; does nothing if hung up."""
        if self.master is None:
            return
        if self.link.is_symlink() and os.readlink(self.link) == self._device:
            self.link.unlink()
        os.close(self.master)
        self.master, self.present = None, False

    def read(self) -> bytes:
        """Return the waiting bytes, and note whether a host is present.

        Returns
        -------
        bytes
            B'' if there are none.
        """
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
        """Send bytes; bytes that no host accepts are lost, as on a wire.

        Parameters
        ----------
        data : bytes
            Bytes to send.
        """
        if self.master is not None and self.present:
            with contextlib.suppress(OSError):
                os.write(self.master, data)
