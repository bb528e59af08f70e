"""Bytes over a serial or network port, through pyserial, with named errors."""

from __future__ import annotations

import errno
import os
import select
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import serial

from microbot_ros.common.patience import PATIENCE
from microbot_ros.drive.errors import (
    PortBusyError,
    PortLostError,
    PortMissingError,
    UnreachableError,
)
from microbot_ros.drive.low_latency import request_low_latency

_SLICE_S = 0.005
"""Longest uninterrupted wait in the kernel [s]: the longest time that `close` from another thread
takes. Choice: the tick of the driver's thread."""
_MOST_AT_ONCE = 4096
"""Largest number of bytes read at once. Choice: a page, so that a babbling device cannot hold the
thread."""
_WITH_DESCRIPTOR = frozenset({'socket', 'hwgrep', 'spy', 'alt'})
"""Kinds of pyserial URLs whose ports belong to the system; `rfc2217`, `loop` and `cp2110` do
not."""


def has_descriptor(url: str) -> bool:
    """Return whether a port has a file descriptor once it is open, judged by its name.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.

    Returns
    -------
    bool
        Whether it has one.
    """
    kind, separator, _ = url.partition('://')
    return not separator or kind in _WITH_DESCRIPTOR


class Port:
    """One open line to an amplifier, closed to every other program and asked for low latency.

    Parameters
    ----------
    url : str
        Device (`/dev/ttyACM0`, `/dev/serial/by-id/…`) or pyserial URL (`socket://`, `rfc2217://`).
    baud : int
        Rate of the line [1/s].
    xon_xoff : bool
        Whether the device may pause the transmission by XOFF.

    Raises
    ------
    PortMissingError
        If the port cannot be opened.
    PortBusyError
        If another program holds it.
    """

    def __init__(self, url: str, baud: int, *, xon_xoff: bool = False) -> None:
        self.url = url
        self._woken = False
        # pyserial's RFC 2217 has no write timeout: there TCP decides when a line is lost.
        write_timeout = None if url.startswith('rfc2217:') else PATIENCE.write_s
        try:
            self._serial = serial.serial_for_url(
                url, baudrate=baud, timeout=_SLICE_S, write_timeout=write_timeout,
                xonxoff=xon_xoff, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            if getattr(error, 'errno', None) in (errno.EBUSY, errno.EAGAIN):
                raise PortBusyError(url) from None
            raise PortMissingError(url, str(error)) from None
        self.low_latency = request_low_latency(self._serial)
        """Whether the system hands over every byte at once."""

    def send(self, data: bytes) -> None:
        """Hand bytes to the line at once.

        pyserial's own limit counts from before the first byte and is checked after the last: a
        process that was delayed meanwhile would lose a line that accepted everything.

        Parameters
        ----------
        data : bytes
            Bytes to send.

        Raises
        ------
        PortLostError
            If the line accepts no byte for 0.1 s.
        """
        with self._named():
            descriptor = self.descriptor
            # pyserial's spy logs only bytes that pass through its own methods.
            if descriptor is None or self.url.startswith('spy:'):
                self._serial.write(data)
                return
            while data:
                if not select.select([], [descriptor], [], PATIENCE.write_s)[1]:
                    raise TimeoutError(f'no byte could be written for {PATIENCE.write_s:g} s')
                data = data[os.write(descriptor, data):]

    def receive(self, timeout_s: float = 0.0) -> bytes:
        """Return the bytes that arrived; wait for the first if there is none.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait [s]; 5 ms more at a port without descriptor. A wait of less than 5
            ms cannot be woken.

        Returns
        -------
        bytes
            B'' if none arrived in time, or if woken.

        Raises
        ------
        PortLostError
            If the port stopped working.
        """
        deadline = time.monotonic() + timeout_s
        brief = timeout_s < _SLICE_S and self.descriptor is not None
        with self._named():
            data = self._waiting()
            while not (data or self._woken) and (left := deadline - time.monotonic()) > 0:
                if brief:
                    select.select([self._serial], [], [], left)
                    data = self._waiting()
                else:
                    data = bytes(self._serial.read(1)) + self._waiting()
            self._woken = False
            return data

    def wake(self) -> None:
        """Make a waiting `receive`, or else the next one, return at once; from any thread."""
        self._woken = True
        # Not every kind of port can be woken; the others check every 5 ms.
        with suppress(AttributeError, OSError, TypeError):
            self._serial.cancel_read()

    @property
    def descriptor(self) -> int | None:
        """File descriptor, if the port belongs to the system."""
        try:
            return int(self._serial.fileno())
        except (AttributeError, OSError):  # a port over RFC 2217 has none
            return None

    def _waiting(self) -> bytes:
        """Return the bytes that can be read at once; a socket reports one byte at a time."""
        data = b''
        while len(data) < _MOST_AT_ONCE and (count := self._serial.in_waiting):
            data += self._serial.read(count)
        return data

    def discard_output(self) -> None:
        """Discard the bytes that were handed to the line and have not gone out."""
        with self._named():
            self._serial.reset_output_buffer()

    def discard_input(self) -> None:
        """Discard the bytes that arrived and were not read."""
        with self._named():
            self._serial.reset_input_buffer()

    def close(self) -> None:
        """Release the port; does nothing if it is released already."""
        # No error of a port may prevent the others from being closed.
        with suppress(Exception):
            self._serial.close()

    @contextmanager
    def _named(self) -> Iterator[None]:
        # pyserial's own errors are OSErrors, but it lets those of termios through, and a port
        # that another thread closed meanwhile shows as a TypeError inside it.
        try:
            yield
        except (OSError, TypeError, termios.error) as error:
            raise PortLostError(self.url, str(error)) from None


class AbsentPort(Port):
    """Stand-in for a port that could not be opened: using it raises the error again.

    Parameters
    ----------
    error : UnreachableError
        Error of the attempt to open it.
    """

    descriptor = None
    low_latency = False

    def __init__(self, error: UnreachableError) -> None:
        self.url = error.url
        self.error = error

    def send(self, data: bytes) -> None:
        raise self.error

    def receive(self, timeout_s: float = 0.0) -> bytes:
        raise self.error

    def wake(self) -> None:
        """Do nothing."""

    def discard_output(self) -> None:
        raise self.error

    def discard_input(self) -> None:
        raise self.error

    def close(self) -> None:
        """Do nothing."""
