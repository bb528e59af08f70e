"""Bytes over a serial port or a network one, through pyserial, with errors that have a name."""

from __future__ import annotations

import errno
import math
import os
import select
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import serial

from microbot_ros.drive.errors import (
    PortBusyError,
    PortLostError,
    PortMissingError,
    UnreachableError,
)
from microbot_ros.drive.low_latency import request_low_latency

_SLICE_S = 0.005
"""Longest uninterrupted wait in the kernel: how long `close` from another thread can take."""
_WRITE_TIMEOUT_S = 0.1
_MOST_AT_ONCE = 4096
_WITH_DESCRIPTOR = frozenset({'socket', 'hwgrep', 'spy', 'alt'})
"""Kinds of pyserial URLs whose ports are of the system's: `rfc2217`, `loop` and `cp2110` are
not."""


def has_descriptor(url: str) -> bool:
    """Return whether the port `url` has a file descriptor once it is open, judged by its name."""
    kind, separator, _ = url.partition('://')
    return not separator or kind in _WITH_DESCRIPTOR


class Port:
    """One open line to an amplifier, closed to every other program.

    `url` is a device (`/dev/ttyACM0`, `/dev/serial/by-id/…`) or a pyserial URL (`socket://`,
    `rfc2217://`), `baud` its rate [1/s], `xon_xoff` whether it may pause us. It is asked for low
    latency. Raises PortMissingError or PortBusyError.
    """

    def __init__(self, url: str, baud: int, *, xon_xoff: bool = False) -> None:
        self.url = url
        self._woken = False
        # pyserial's RFC 2217 has no write timeout: there TCP decides when a line is lost.
        write_timeout = None if url.startswith('rfc2217:') else _WRITE_TIMEOUT_S
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
        """Hand `data` to the line at once. Raises PortLostError where it takes none for 0.1 s.

        pyserial's own limit counts from before the first byte and is looked at after the last: a
        process that was held up meanwhile would lose a line that took everything.
        """
        with self._named():
            descriptor = self.descriptor
            # pyserial's spy logs what goes through its own methods alone.
            if descriptor is None or self.url.startswith('spy:'):
                self._serial.write(data)
                return
            while data:
                if not _ready(descriptor, select.POLLOUT, _WRITE_TIMEOUT_S):
                    raise TimeoutError(f'no byte could be written for {_WRITE_TIMEOUT_S:g} s')
                data = data[os.write(descriptor, data):]

    def receive(self, timeout_s: float = 0.0) -> bytes:
        """What has arrived; waits for the first byte at most `timeout_s` (+ 5 ms at a port that is
        none of the system's), or until woken, then b''. A wait of less than 5 ms is not woken.
        """
        deadline = time.monotonic() + timeout_s
        brief = timeout_s < _SLICE_S and self.descriptor is not None
        with self._named():
            data = self._waiting()
            while not (data or self._woken) and (left := deadline - time.monotonic()) > 0:
                if brief:
                    _ready(self._serial.fileno(), select.POLLIN, left)
                    data = self._waiting()
                else:
                    data = bytes(self._serial.read(1)) + self._waiting()
            self._woken = False
            return data

    def wake(self) -> None:
        """Let a `receive` that waits, or else the next one, return without waiting; from any
        thread."""
        self._woken = True
        # Not every kind of port can be woken; those that cannot look every 5 ms.
        with suppress(AttributeError, OSError, TypeError):
            self._serial.cancel_read()

    @property
    def descriptor(self) -> int | None:
        """The file descriptor, where the port is one of the system's."""
        try:
            return int(self._serial.fileno())
        except (AttributeError, OSError):  # a port over RFC 2217 has none
            return None

    def _waiting(self) -> bytes:
        """What is there to be read without waiting; a socket tells of one byte at a time."""
        data = b''
        while len(data) < _MOST_AT_ONCE and (count := self._serial.in_waiting):
            data += self._serial.read(count)
        return data

    def discard_output(self) -> None:
        """Take back what was handed to the line and has not gone out."""
        with self._named():
            self._serial.reset_output_buffer()

    def discard_input(self) -> None:
        """Forget what arrived and was not read."""
        with self._named():
            self._serial.reset_input_buffer()

    def close(self) -> None:
        """Give the port back; harmless when it is gone already."""
        # Whatever a kind of port fails with must not keep its neighbours from being closed.
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


def _ready(descriptor: int, event: int, timeout_s: float) -> bool:
    """Wait at most `timeout_s` [s] for an `event` of select.poll; return whether it came.

    Unlike select.select it takes descriptors of 1024 and more.
    """
    poller = select.poll()
    poller.register(descriptor, event)
    return bool(poller.poll(math.ceil(1000 * timeout_s)))


class AbsentPort(Port):
    """Stand-in for a port that could not be opened: using it raises the `error` again."""

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
        """Nothing waits."""

    def discard_output(self) -> None:
        raise self.error

    def discard_input(self) -> None:
        raise self.error

    def close(self) -> None:
        """Nothing is open."""
