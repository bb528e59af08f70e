"""A camera whose maker's program leaves the newest picture in a file of shared memory.

The file holds the picture's number, and height and width [px], as three 64-bit integers, its
moment on the monotonic clock [s] as a double, and its pixels, a byte each.
"""

import mmap
import struct
import time

import numpy as np

from microbot_ros.cameras.camera import CameraDriver, CameraFormat, CameraFrame, Clock
from microbot_ros.common.errors import InputError

HEAD = struct.Struct('<3qd')


class SharedMemoryCamera(CameraDriver):
    """The newest picture, whenever there is a new one; those in between count as lost."""

    def open(self):
        self.refuse(*self.wanted.asked, why="set it in the camera's own program")
        try:
            with open(self.wanted.source, 'rb') as file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise InputError(self.wanted.source, f'expected shared memory ({error})') from None
        self._seen, height, width, _ = HEAD.unpack_from(self._memory)
        self._shape = height, width
        return CameraFormat(height, width, 'mono8', 'Mono8', Clock.HOST)

    def read(self, timeout):
        deadline = time.monotonic() + timeout
        while (number := HEAD.unpack_from(self._memory)[0]) == self._seen:
            if time.monotonic() >= deadline:
                return None
            time.sleep(0.0005)
        self._seen = number
        exposed = HEAD.unpack_from(self._memory)[3]
        count = self._shape[0] * self._shape[1]
        image = np.frombuffer(self._memory, np.uint8, count, HEAD.size).reshape(self._shape)
        return CameraFrame(number, image, time.monotonic(), exposed)

    def close(self):
        self._memory = None
