"""Camera kind `file`: a video, a folder of images or a glob, at its own rate."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np

from microbot_ros.cameras.camera import CameraDriver, CameraFormat, CameraFrame, Clock, EndOfFrames
from microbot_ros.cameras.source import Frame, open_source
from microbot_ros.common.errors import InputError


class FileCamera(CameraDriver):
    """Frames of a file, each at its time.

    Frames that cannot be decoded are reported and skipped.
    """

    def open(self) -> CameraFormat:
        if not self.wanted.source:
            raise InputError('camera', 'expected the parameter source: a device, a video or a '
                                       'folder of images')
        self.refuse(*(set(self.wanted.asked) - {'frame_rate_hz'}), why='it is a file')
        source = open_source(self.wanted.source, self.report, self.wanted.frame_rate_hz or None)
        self._frames: Iterator[Frame] = source.frames()
        self._next: Frame | None = None
        self._depth: np.dtype | None = None
        self._count = 0
        self._begin = math.nan
        first = self._peek()
        deep = first.image.dtype.itemsize == 2
        height, width = source.size
        return CameraFormat(
            height, width, 'mono16' if deep else 'mono8', 'decoded to grey', Clock.NONE,
            frame_rate=source.frame_rate, sensor=source.size, patience=math.inf)

    def read(self, timeout: float) -> CameraFrame | None:
        frame, now = self._peek(), time.monotonic()
        if math.isnan(self._begin):
            self._begin = now - frame.t
        # Timed from the start and not from the previous frame, so that delays do not add up.
        due = self._begin + frame.t
        time.sleep(min(max(0.0, due - now), timeout))
        if due > now + timeout:
            return None
        self._next = None
        self._count += 1
        return CameraFrame(frame.index, frame.image, time.monotonic())

    def close(self) -> None:
        self._frames = iter(())

    def _peek(self) -> Frame:
        while self._next is None:
            frame = next(self._frames, None)
            if frame is None:
                raise EndOfFrames(f'{self.wanted.source} ended after {self._count} frames')
            if self._depth in (None, frame.image.dtype):
                self._next, self._depth = frame, frame.image.dtype
            else:
                self.report(f'{self.wanted.source}: frame {frame.index} is {frame.image.dtype}, '
                            f'expected {self._depth}; left out')
        return self._next
