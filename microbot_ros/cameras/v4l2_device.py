"""Video4Linux2 as the kernel has it: requests and structures of <linux/videodev2.h>, 64 bit.

OpenCV reads such cameras too, but gives neither the number of a frame nor the clock of its stamp;
the libraries that do are under licences that this package can't take in.
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
    """A request's code: _IOC of <asm-generic/ioctl.h> with type 'V'."""
    return direction << 30 | layout.size << 16 | ord('V') << 8 | number


_READ, _WRITE, _BOTH = 2, 1, 3
QUERYCAP = _request(_READ, 0, _CAPABILITY)
ENUM_FMT = _request(_BOTH, 2, _DESCRIPTION)
G_FMT, S_FMT = _request(_BOTH, 4, _FORMAT), _request(_BOTH, 5, _FORMAT)
REQBUFS = _request(_BOTH, 8, _REQUEST)
QUERYBUF, QBUF, DQBUF = (_request(_BOTH, number, _BUFFER) for number in (9, 15, 17))
STREAMON, STREAMOFF = _request(_WRITE, 18, _INT), _request(_WRITE, 19, _INT)
G_PARM, S_PARM = _request(_BOTH, 21, _PARAMETERS), _request(_BOTH, 22, _PARAMETERS)
G_CTRL, S_CTRL = _request(_BOTH, 27, _CONTROL), _request(_BOTH, 28, _CONTROL)
QUERYCTRL = _request(_BOTH, 36, _LIMITS)
S_SELECTION = _request(_BOTH, 95, _SELECTION)

AUTOGAIN, GAIN = 0x00980912, 0x00980913
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE = 0x009A0901, 0x009A0902
EXPOSURE_MANUAL = 1

_CAPTURE, _MMAP, _CROP = 1, 1, 0
_CAN_CAPTURE, _CAN_STREAM, _DEVICE_CAPS = 0x1, 0x0400_0000, 0x8000_0000
_TIME_PER_FRAME, _DISABLED = 0x1000, 0x1
_BROKEN = 0x40
_CLOCK, _MONOTONIC = 0xE000, 0x2000
_SOURCE, _START_OF_EXPOSURE = 0x70000, 0x10000
_BUFFERS = 8

Ioctl = Callable[[int, int, bytearray], int]


@dataclass(frozen=True)
class PixelLayout:
    """What is negotiated: `width` and `height` [px], `pixel_format` (a four-character code) and
    the length of a row, `stride` [bytes], and of a picture, `size` [bytes]."""

    width: int
    height: int
    pixel_format: str
    stride: int
    size: int


@dataclass(frozen=True)
class Captured:
    """A filled buffer: its `data` until it is given back, the driver's `sequence` number, the
    `time` [s] of its stamp, whether that is of the `monotonic` clock and of the exposure's
    `start`; `broken` where data are missing."""

    data: memoryview
    sequence: int
    time: float
    monotonic: bool
    start: bool
    broken: bool


class VideoDevice:
    """One opened device by its `path`, streaming through buffers shared with the kernel.

    OSError where the system refuses. `ioctl` is the system's.
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
                raise OSError(errno.ENOTSUP, 'no camera that streams')
        except BaseException:
            os.close(self._file)
            raise

    def close(self) -> None:
        """Stop and give everything back; no complaint of a device that is gone."""
        with suppress(OSError):
            self._ask(STREAMOFF, _INT, _CAPTURE)
        self._held = None
        for each in self._maps:
            # A picture that somebody still holds keeps its memory until it goes.
            with suppress(BufferError):
                each.close()
        self._maps.clear()
        with suppress(OSError):
            self._ask(REQBUFS, _REQUEST, 0, _CAPTURE, _MMAP)
        with suppress(OSError):
            os.close(self._file)

    def pixel_formats(self) -> list[str]:
        """Four-character codes of all it has, in its own order."""
        found: list[str] = []
        with suppress(OSError):
            while True:
                told = self._ask(ENUM_FMT, _DESCRIPTION, len(found), _CAPTURE, 0, b'', 0)
                found.append(_name(told[4]))
        return found

    def layout(self) -> PixelLayout:
        """What it gives now."""
        return _layout(self._ask(G_FMT, _FORMAT, _CAPTURE, *[0] * 6))

    def lay_out(self, width: int, height: int, pixel_format: str) -> PixelLayout:
        """Ask for `width`, `height` and `pixel_format`; what it makes of that, perhaps others."""
        return _layout(self._ask(S_FMT, _FORMAT, _CAPTURE, width, height, _code(pixel_format), 0,
                                 0, 0))

    def crop(self, left: int, top: int, width: int, height: int) -> tuple[int, int, int, int]:
        """Ask for the region of `width` × `height` with its corner at `left`, `top`; what it
        makes of that."""
        told = self._ask(S_SELECTION, _SELECTION, _CAPTURE, _CROP, 0, left, top, width, height)
        return told[3], told[4], told[5], told[6]

    def frame_rate(self) -> float | None:
        """Frames per second; None where it does not say."""
        try:
            _, can, _, part, whole = self._ask(G_PARM, _PARAMETERS, _CAPTURE, 0, 0, 0, 0)
        except OSError:
            return None
        return whole / part if can & _TIME_PER_FRAME and part and whole else None

    def ask_frame_rate(self, rate: float) -> float | None:
        """Ask for a `rate` [Hz]; what it makes of that, None where it has none to set."""
        try:
            self._ask(S_PARM, _PARAMETERS, _CAPTURE, 0, 0, 1000, round(rate * 1000))
        except OSError:
            return None
        return self.frame_rate()

    def limits(self, control: int) -> tuple[int, int] | None:
        """Lowest and highest value of a `control`; None where it has none of that kind."""
        try:
            told = self._ask(QUERYCTRL, _LIMITS, control, 0, b'', 0, 0, 0, 0, 0)
        except OSError:
            return None
        return None if told[7] & _DISABLED else (told[3], told[4])

    def set(self, control: int, value: int) -> None:
        """Give a `control` a `value`."""
        self._ask(S_CTRL, _CONTROL, control, value)

    def get(self, control: int) -> int | None:
        """The value of a `control`; None where it has none."""
        try:
            return int(self._ask(G_CTRL, _CONTROL, control, 0)[1])
        except OSError:
            return None

    def start(self) -> None:
        """Share buffers and let frames come."""
        count = self._ask(REQBUFS, _REQUEST, _BUFFERS, _CAPTURE, _MMAP)[0]
        for index in range(count):
            told = self._buffer(QUERYBUF, index)
            self._maps.append(mmap.mmap(self._file, told[10], offset=told[9]))
            self._buffer(QBUF, index)
        self._ask(STREAMON, _INT, _CAPTURE)

    def capture(self, timeout: float) -> Captured | None:
        """The oldest filled buffer, which is given back with the next call; None where none was
        filled within `timeout` [s]."""
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
