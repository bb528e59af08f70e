"""Identity of the USB adapter behind a serial port, so that no other adapter is ever driven."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass

from serial.tools.list_ports import comports

BY_ID = '/dev/serial/by-id/'
"""Directory where udev puts names of serial ports that contain the adapter's serial number (udev's
`60-serial.rules`)."""
_REPLACED = re.compile(r'[^\w#+\-.:=@]')
"""Characters that udev replaces by an underscore in a name (udev's list of allowed characters)."""


@dataclass(frozen=True)
class Adapter:
    """Identity of a USB adapter: vendor id, product id and serial number ('' for none)."""

    vendor: int
    product: int
    serial_number: str

    def __str__(self) -> str:
        number = f'serial number {self.serial_number}' if self.serial_number else 'no number'
        return f'USB {self.vendor:04x}:{self.product:04x}, {number}'

    def may_be_named(self, url: str) -> bool:
        """Return whether udev can have given this adapter the name `url`.

        Parameters
        ----------
        url : str
            Name of a port.

        Returns
        -------
        bool
            True for every name outside `/dev/serial/by-id/`, which contains no information on the
            adapter.
        """
        return not url.startswith(BY_ID) or _REPLACED.sub('_', self.serial_number) in url


def adapter_at(url: str) -> Adapter | None:
    """Return the USB adapter behind a port, as pyserial's `list_ports` reports it.

    Parameters
    ----------
    url : str
        Device name or pyserial URL.

    Returns
    -------
    Adapter or None
        None for a port without USB identity: a pseudo-terminal, a port on the board, a port over a
        network, or a device that does not exist.
    """
    if '://' in url:
        return None
    device = os.path.realpath(url)
    with suppress(OSError):  # an adapter that is unplugged meanwhile
        for port in comports():
            if port.device == device and port.vid is not None:
                return Adapter(port.vid, port.pid, port.serial_number or '')
    return None
