"""Video4Linux2 interface of the kernel: requests and structures of <linux/videodev2.h>, 64 bit.

OpenCV reads such cameras too, but gives neither frame numbers nor the clock of the time stamps.
The libraries that do have licences incompatible with this package.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import select
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

_CAPABILITY = struct.Struct('<16s32s32s3I12x')
_FORMAT = struct.Struct('<I4x6I176x')
_REQUEST = struct.Struct('<3I8x')
_BUFFER = struct.Struct('<5I4x2q16x2IQ I12x')
_PARAMETERS = struct.Struct('<3I2I184x')
_CONTROL = struct.Struct('<Ii')
_LIMITS = struct.Struct('<2I32s5i8x')
_SELECTION = struct.Struct('<3I2i2I36x')
_DESCRIPTION = struct.Struct('<3I32sI16x')
_INT = struct.Struct('<i')


def _request(direction: int, number: int, layout: struct.Struct) -> int:
    """Return the code of a request: _IOC of <asm-generic/ioctl.h> with type 'V'."""
    return direction << 30 | layout.size << 16 | ord('V') << 8 | number


# Values from the headers of Linux, <linux/videodev2.h> and <linux/v4l2-controls.h>.
_READ, _WRITE, _BOTH = 2, 1, 3
QUERYCAP = _request(_READ, 0, _CAPABILITY)  # videodev2.h
ENUM_FMT = _request(_BOTH, 2, _DESCRIPTION)  # videodev2.h
G_FMT, S_FMT = _request(_BOTH, 4, _FORMAT), _request(_BOTH, 5, _FORMAT)  # videodev2.h
REQBUFS = _request(_BOTH, 8, _REQUEST)  # videodev2.h
QUERYBUF, QBUF, DQBUF = (_request(_BOTH, number, _BUFFER) for number in (9, 15, 17))  # videodev2.h
STREAMON, STREAMOFF = _request(_WRITE, 18, _INT), _request(_WRITE, 19, _INT)  # videodev2.h
G_PARM, S_PARM = _request(_BOTH, 21, _PARAMETERS), _request(_BOTH, 22, _PARAMETERS)  # videodev2.h
G_CTRL, S_CTRL = _request(_BOTH, 27, _CONTROL), _request(_BOTH, 28, _CONTROL)  # videodev2.h
QUERYCTRL = _request(_BOTH, 36, _LIMITS)  # videodev2.h
S_SELECTION = _request(_BOTH, 95, _SELECTION)  # videodev2.h

AUTOGAIN, GAIN = 0x00980912, 0x00980913  # v4l2-controls.h
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE = 0x009A0901, 0x009A0902  # v4l2-controls.h
EXPOSURE_MANUAL = 1  # v4l2-controls.h

_CAPTURE, _MMAP, _CROP = 1, 1, 0  # videodev2.h
_CAN_CAPTURE, _CAN_STREAM, _DEVICE_CAPS = 0x1, 0x0400_0000, 0x8000_0000  # videodev2.h
_TIME_PER_FRAME, _DISABLED = 0x1000, 0x1  # videodev2.h
_BROKEN = 0x40  # videodev2.h
_CLOCK, _MONOTONIC = 0xE000, 0x2000  # videodev2.h
_SOURCE, _START_OF_EXPOSURE = 0x70000, 0x10000  # videodev2.h
_BUFFERS = 8  # choice: 80 ms of frames at 100 frames/s

Ioctl = Callable[[int, int, bytearray], int]


@dataclass(frozen=True)
class PixelLayout:
    """Negotiated layout of a picture.

    `width` and `height` [px], `pixel_format` (four-character code), `stride`: length of a row
    [bytes], `size` of a picture [bytes].
    """

    width: int
    height: int
    pixel_format: str
    stride: int
    size: int


@dataclass(frozen=True)
class Captured:
    """Filled buffer of a device.

    `data` is valid until the next capture; `sequence` is the driver's frame number and `time` [s]
    its stamp, on the monotonic clock if `monotonic`, of the start of the exposure if `start`;
    `broken` if data are missing.
    """

    data: memoryview
    sequence: int
    time: float
    monotonic: bool
    start: bool
    broken: bool


class VideoDevice:
    """Open device at `path` that streams through buffers shared with the kernel.

    Raises OSError if the system refuses. `ioctl` is the system call, replaced in tests.

    Parameters
    ----------
    path : str
        Path of the device.
    ioctl : Ioctl
        The system call.
    """

    def __init__(self, path: str, ioctl: Ioctl = fcntl.ioctl) -> None:
        self._ioctl = ioctl
        self._maps: list[mmap.mmap] = []
        self._held: int | None = None
        self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            *_, capabilities, own = self._ask(QUERYCAP, _CAPABILITY, b'', b'', b'', 0, 0, 0)
            can = own if capabilities & _DEVICE_CAPS else capabilities
            if not (can & _CAN_CAPTURE and can & _CAN_STREAM):
                raise OSError(errno.ENOTSUP, 'not a camera that can stream')
        except BaseException:
            os.close(self._file)
            raise

    def close(self) -> None:
        """Stop streaming and release everything, without errors for a disconnected device."""
        with suppress(OSError):
            self._ask(STREAMOFF, _INT, _CAPTURE)
        self._held = None
        for each in self._maps:
            # A picture still in use keeps its memory mapped until it is released.
            with suppress(BufferError):
                each.close()
        self._maps.clear()
        with suppress(OSError):
            self._ask(REQBUFS, _REQUEST, 0, _CAPTURE, _MMAP)
        with suppress(OSError):
            os.close(self._file)

    def pixel_formats(self) -> list[str]:
        """Return the four-character codes of its pixel formats, in the device's order.

        Returns
        -------
        list of str
            The codes.
        """
        found: list[str] = []
        with suppress(OSError):
            while True:
                told = self._ask(ENUM_FMT, _DESCRIPTION, len(found), _CAPTURE, 0, b'', 0)
                found.append(_name(told[4]))
        return found

    def layout(self) -> PixelLayout:
        """Return the present layout.

        Returns
        -------
        PixelLayout
            The layout.
        """
        return _layout(self._ask(G_FMT, _FORMAT, _CAPTURE, *[0] * 6))

    def lay_out(self, width: int, height: int, pixel_format: str) -> PixelLayout:
        """Request `width`, `height` [px] and `pixel_format`; return the layout chosen.

        Parameters
        ----------
        width : int
            Width [px].
        height : int
            Height [px].
        pixel_format : str
            Four-character code.

        Returns
        -------
        PixelLayout
            The layout that the device chose.
        """
        return _layout(self._ask(S_FMT, _FORMAT, _CAPTURE, width, height, _code(pixel_format), 0,
                                 0, 0))

    def crop(self, left: int, top: int, width: int, height: int) -> tuple[int, int, int, int]:
        """Request the region of `width` × `height` with its corner at `left`, `top` [px].

        Returns the region that the device chose, in the same order.

        Parameters
        ----------
        left : int
            Left edge [px].
        top : int
            Upper edge [px].
        width : int
            Width [px].
        height : int
            Height [px].

        Returns
        -------
        tuple[int, int, int, int]
            Region that the device chose [px].
        """
        told = self._ask(S_SELECTION, _SELECTION, _CAPTURE, _CROP, 0, left, top, width, height)
        return told[3], told[4], told[5], told[6]

    def frame_rate(self) -> float | None:
        """Return the frame rate [Hz]; None if the device does not report it.

        Returns
        -------
        float or None
            Rate [Hz], or None.
        """
        try:
            _, can, _, part, whole = self._ask(G_PARM, _PARAMETERS, _CAPTURE, 0, 0, 0, 0)
        except OSError:
            return None
        return whole / part if can & _TIME_PER_FRAME and part and whole else None

    def ask_frame_rate(self, rate: float) -> float | None:
        """Request a `rate` [Hz]; return the one the device chose, or None if it cannot be set.

        Parameters
        ----------
        rate : float
            Rate [Hz].

        Returns
        -------
        float or None
            Rate [Hz], or None.
        """
        try:
            self._ask(S_PARM, _PARAMETERS, _CAPTURE, 0, 0, 1000, round(rate * 1000))
        except OSError:
            return None
        return self.frame_rate()

    def limits(self, control: int) -> tuple[int, int] | None:
        """Return the lowest and highest value of a `control`; None if the device has none.

        Parameters
        ----------
        control : int
            Number of the control.

        Returns
        -------
        tuple[int, int] or None
            Lowest and highest value, or None.
        """
        try:
            told = self._ask(QUERYCTRL, _LIMITS, control, 0, b'', 0, 0, 0, 0, 0)
        except OSError:
            return None
        return None if told[7] & _DISABLED else (told[3], told[4])

    def set(self, control: int, value: int) -> None:
        """Set a `control` to `value`.

        Parameters
        ----------
        control : int
            Number of the control.
        value : int
            Value of the control.
        """
        self._ask(S_CTRL, _CONTROL, control, value)

    def get(self, control: int) -> int | None:
        """Return the value of a `control`; None if the device has none.

        Parameters
        ----------
        control : int
            Number of the control.

        Returns
        -------
        int or None
            The value, or None.
        """
        try:
            return int(self._ask(G_CTRL, _CONTROL, control, 0)[1])
        except OSError:
            return None

    def start(self) -> None:
        """Share buffers with the kernel and start streaming."""
        count = self._ask(REQBUFS, _REQUEST, _BUFFERS, _CAPTURE, _MMAP)[0]
        for index in range(count):
            told = self._buffer(QUERYBUF, index)
            self._maps.append(mmap.mmap(self._file, told[10], offset=told[9]))
            self._buffer(QBUF, index)
        self._ask(STREAMON, _INT, _CAPTURE)

    def capture(self, timeout: float) -> Captured | None:
        """Return the oldest filled buffer, or None if none is filled within `timeout` [s].

        The buffer goes back to the device with the next call.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Returns
        -------
        Captured or None
            The buffer, or None.
        """
        if self._held is not None:
            index, self._held = self._held, None
            self._buffer(QBUF, index)
        if not select.select([self._file], [], [], timeout)[0]:
            return None
        try:
            told = self._buffer(DQBUF, 0)
        except BlockingIOError:
            return None
        index, _, used, flags, _, seconds, microseconds, sequence = told[:8]
        self._held = index
        return Captured(
            memoryview(self._maps[index])[:used], sequence, seconds + microseconds * 1e-6,
            flags & _CLOCK == _MONOTONIC, flags & _SOURCE == _START_OF_EXPOSURE,
            bool(flags & _BROKEN))

    def _buffer(self, request: int, index: int) -> tuple[int, ...]:
        return self._ask(request, _BUFFER, index, _CAPTURE, 0, 0, 0, 0, 0, 0, _MMAP, 0, 0)

    def _ask(self, request: int, layout: struct.Struct, *values: object) -> tuple[Any, ...]:
        data = bytearray(layout.pack(*values))
        self._ioctl(self._file, request, data)
        return layout.unpack(data)


def _layout(told: tuple[int, ...]) -> PixelLayout:
    _, width, height, code, _, stride, size = told
    return PixelLayout(width, height, _name(code), stride, size)


def _code(name: str) -> int:
    return int.from_bytes(name.ljust(4).encode('ascii'), 'little')


def _name(code: int) -> str:
    return (code & 0x7FFF_FFFF).to_bytes(4, 'little').decode('ascii', 'replace').rstrip()
