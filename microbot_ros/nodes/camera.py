"""Node `camera`: frames of a device, a video or a folder of images, stamped at exposure."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from sensor_msgs.msg import Image

from microbot_ros.errors import InputError
from microbot_ros.nodes import messages
from microbot_ros.nodes.lifecycle import ERROR, IMAGES_OUT, OK, WARN, RigNode
from microbot_ros.settings import setting
from microbot_ros.tracking.source import DeviceSource, Frame, Source, open_source

_RETRY_SECONDS = 1.0


@dataclass(frozen=True)
class CameraParameters:
    """Parameters of the node `camera`."""

    source: str = setting(
        '', 'What to read: a device number (0) or path (/dev/video0), a video file, a folder of '
        'images or a glob. Nothing else is tried when it cannot be opened.', read_only=True)
    frame_rate_hz: float = setting(
        0.0, 'Pace of a file; 0 takes the rate that the file says. A device sets its own pace.',
        lower=0.0, upper=1000.0, read_only=True)
    loop: bool = setting(False, 'Start a file again at its end.')


class CameraNode(RigNode):
    """Publishes `camera/image_raw` from a thread of its own, because devices block."""

    Parameters: ClassVar[type] = CameraParameters

    def setup(self) -> None:
        self._frames = 0
        self._finished = ''
        self._stopping = threading.Event()
        self._open()
        self._images = self.publisher(Image, 'camera/image_raw', IMAGES_OUT)

    def start(self) -> None:
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, name='camera', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        if hasattr(self, '_thread'):
            self._thread.join(timeout=2.0)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        values: dict[str, object] = {'frames_published': self._frames}
        if self._finished:
            return (WARN if self._is_file else ERROR), self._finished, values
        return OK, f'publishing {self._source.name}', values

    def _open(self) -> None:
        source = self.settings.source
        if not source:
            raise InputError(self.get_name(), 'expected a parameter source: a device, a video or '
                                              'a folder of images')
        self._is_file = not (source.isdigit() or source.startswith('/dev/'))
        if self._is_file:
            rate = self.settings.frame_rate_hz or None
            self._source: Source = open_source(source, self.get_logger().warning, rate)
        else:
            self._source = DeviceSource(int(source) if source.isdigit() else source)

    def _run(self) -> None:
        play: Callable[[], None] = self._play_file if self._is_file else self._play_device
        try:
            play()
        except Exception as error:
            self._failed('camera', error)
            self._finished = f'stopped: {error}'

    def _play_file(self) -> None:
        while not self._stopping.is_set():
            begin = time.monotonic()
            for frame in self._source.frames():
                # Pacing against the start, not the last frame: lateness does not add up.
                if self._stopping.wait(max(0.0, begin + frame.t - time.monotonic())):
                    return
                self._publish(frame)
            if not self.settings.loop:
                self._finished = f'{self._source.name} ended after {self._frames} frames'
                self.get_logger().info(self._finished)
                return

    def _play_device(self) -> None:
        while not self._stopping.is_set():
            try:
                for frame in self._source.frames():
                    self._finished = ''
                    self._publish(frame)
                    if self._stopping.is_set():
                        return
            except InputError as error:
                self._finished = f'{error}; trying the same device again'
                self.complain(self._finished)
            while self._finished and not self._stopping.wait(_RETRY_SECONDS):
                with contextlib.suppress(InputError):
                    self._open()
                    break

    def _publish(self, frame: Frame) -> None:
        stamp = self.seconds()
        if not self._is_file:
            stamp -= time.monotonic() - frame.t
        self._images.publish(messages.image(frame.image, messages.to_stamp(stamp)))
        self._frames += 1
