"""A kernel with one camera, by the byte offsets of <linux/videodev2.h> on 64 bit."""

from __future__ import annotations

import errno
import os
import struct
from collections import deque

# What a C program prints that includes the header.
CODES = {
    'QUERYCAP': 2154321408, 'ENUM_FMT': 3225441794, 'G_FMT': 3234878980, 'S_FMT': 3234878981,
    'REQBUFS': 3222558216, 'QUERYBUF': 3227014665, 'QBUF': 3227014671, 'DQBUF': 3227014673,
    'STREAMON': 1074026002, 'STREAMOFF': 1074026003, 'G_PARM': 3234616853, 'S_PARM': 3234616854,
    'G_CTRL': 3221771803, 'S_CTRL': 3221771804, 'QUERYCTRL': 3225703972,
    'S_SELECTION': 3225441887,
}
MONOTONIC, START_OF_EXPOSURE, BROKEN = 0x2000, 0x10000, 0x40
EXPOSURE_AUTO, EXPOSURE, GAIN = 10094849, 10094850, 9963795


class Kernel:
    """Answers requests, keeps the books, and fills buffers when told to."""

    def __init__(self, file, formats=('YUYV', 'GREY', 'MJPG'), size=(64, 48), padding=0):
        self.file, self.formats, self.padding = file, formats, padding
        self.format, self.size, self.rate = formats[0], size, (1, 30)
        self.controls = {EXPOSURE_AUTO: [3, 0, 3], EXPOSURE: [100, 3, 2000], GAIN: [10, 0, 64]}
        self.sizes = [size]
        self.queued, self.filled = deque(), deque()
        self.streaming = self.gone = False
        self.crop = None

    @property
    def stride(self):
        per_pixel = {'YUYV': 2, 'UYVY': 2, 'Y16': 2, 'BGR3': 3}.get(self.format, 1)
        return self.size[0] * per_pixel + self.padding

    @property
    def length(self):
        return 4096 * -(-self.stride * self.size[1] // 4096)

    def ioctl(self, file, request, data):
        """As the system's."""
        assert isinstance(data, bytearray)
        if self.gone:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        name = next(name for name, code in CODES.items() if code == request)
        assert len(data) == request >> 16 & 0x3FFF
        getattr(self, '_' + name.lower())(data)
        return 0

    def fill(self, payload, sequence, time, flags=MONOTONIC | START_OF_EXPOSURE):
        """A frame, into the oldest queued buffer; lost where there is none."""
        if self.queued:
            index = self.queued.popleft()
            with open(self.file, 'r+b') as memory:
                memory.seek(index * self.length)
                memory.write(payload)
            self.filled.append((index, len(payload), sequence, time, flags))

    def _querycap(self, data):
        struct.pack_into('<I', data, 84, 0x8420_0001)
        struct.pack_into('<I', data, 88, 0x0420_0001)

    def _enum_fmt(self, data):
        index = struct.unpack_from('<I', data)[0]
        if index >= len(self.formats):
            raise OSError(errno.EINVAL, 'no more')
        data[44:48] = self.formats[index].ljust(4).encode()

    def _g_fmt(self, data):
        struct.pack_into('<2I', data, 8, *self.size)
        data[16:20] = self.format.ljust(4).encode()
        struct.pack_into('<2I', data, 24, self.stride, self.stride * self.size[1])

    def _s_fmt(self, data):
        wanted = struct.unpack_from('<2I', data, 8)
        self.size = wanted if wanted in self.sizes else self.sizes[0]
        name = data[16:20].decode().rstrip()
        self.format = name if name in self.formats else self.formats[0]
        self._g_fmt(data)

    def _reqbufs(self, data):
        self.count = min(struct.unpack_from('<I', data)[0], 4)
        struct.pack_into('<I', data, 0, self.count)
        with open(self.file, 'r+b') as memory:
            memory.truncate(max(1, self.count) * self.length)

    def _querybuf(self, data):
        index = struct.unpack_from('<I', data)[0]
        struct.pack_into('<I', data, 64, index * self.length)
        struct.pack_into('<I', data, 72, self.length)

    def _qbuf(self, data):
        index, kind = struct.unpack_from('<2I', data)
        assert (kind, struct.unpack_from('<I', data, 60)[0]) == (1, 1), 'capture, shared memory'
        assert index not in self.queued
        self.queued.append(index)

    def _dqbuf(self, data):
        if not self.filled:
            raise BlockingIOError(errno.EAGAIN, 'none is filled')
        index, used, sequence, time, flags = self.filled.popleft()
        struct.pack_into('<5I', data, 0, index, 1, used, flags, 1)
        struct.pack_into('<2q', data, 24, int(time), round(time % 1 * 1e6))
        struct.pack_into('<I', data, 56, sequence)

    def _streamon(self, data):
        assert struct.unpack('<i', data)[0] == 1
        self.streaming = True

    def _streamoff(self, data):
        self.streaming = False

    def _g_parm(self, data):
        struct.pack_into('<I', data, 4, 0x1000)
        struct.pack_into('<2I', data, 12, *self.rate)

    def _s_parm(self, data):
        part, whole = struct.unpack_from('<2I', data, 12)
        self.rate = (1, 60 if whole / part > 45 else 30)
        self._g_parm(data)

    def _control(self, data):
        number = struct.unpack_from('<I', data)[0]
        if number not in self.controls:
            raise OSError(errno.EINVAL, 'no such control')
        return self.controls[number]

    def _g_ctrl(self, data):
        struct.pack_into('<i', data, 4, self._control(data)[0])

    def _s_ctrl(self, data):
        self._control(data)[0] = struct.unpack_from('<i', data, 4)[0]

    def _queryctrl(self, data):
        struct.pack_into('<2i', data, 40, *self._control(data)[1:])

    def _s_selection(self, data):
        if self.crop is None:
            raise OSError(errno.ENOTTY, 'no cropping')
        self.crop = struct.unpack_from('<4i', data, 12)
