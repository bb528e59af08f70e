"""Node `camera`: frames of a device, a video or a folder of images, stamped at exposure."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import ClassVar

from sensor_msgs.msg import CameraInfo, Image

from microbot_ros.cameras.camera import (
    CameraFrame,
    CameraSettings,
    EndOfFrames,
    camera_class,
    kind_of,
)
from microbot_ros.cameras.stream import FrameStream
from microbot_ros.common.errors import InputError
from microbot_ros.common.patience import PATIENCE
from microbot_ros.common.settings import setting
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import ERROR, IMAGES_OUT, OK, WARN, RigNode
from microbot_ros.nodes.base.preview import Preview

_FRESH_SECONDS = 1.0
"""Time [s] that an open camera may wait to be started. Choice: frames gathered for longer are
discarded with their stream."""
_TURN_SECONDS = 0.1
"""Longest wait [s] for a frame. Choice: a stop takes effect within it; shorter waits cost
wake-ups."""


@dataclass(frozen=True)
class CameraParameters(CameraSettings):
    """Parameters of the node `camera`."""

    camera: str = setting(
        '', 'Kind of camera: file, v4l2, pylon, micromanager, aravis, or one of a package of '
        'your own. Empty: v4l2 where the source is a device number or path, else file.',
        read_only=True)
    loop: bool = setting(False, 'Start a file again at its end.')


class CameraNode(RigNode):
    """Node that publishes `camera/image_raw` from its own thread, because devices block.

    It publishes `camera/camera_info` with each frame, and `camera/preview` for screens.
    """

    Parameters: ClassVar[type] = CameraParameters

    def setup(self) -> None:
        self._published = self._lost = self._repeated = 0
        self._told_lost = 0
        self._longest = 0.0
        self._finished = self._trouble = ''
        self._stopping = threading.Event()
        self._stream: FrameStream | None = None
        self._open()
        self._images = self.publisher(Image, 'camera/image_raw', IMAGES_OUT)
        self._info = self.publisher(CameraInfo, 'camera/camera_info', IMAGES_OUT)
        self._preview = Preview(self)

    def start(self) -> None:
        self._stopping.clear()
        self._finished = self._trouble = ''
        if time.monotonic() - self._opened > _FRESH_SECONDS:
            self._close()
        self._thread = threading.Thread(target=self._run, name='camera', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        if hasattr(self, '_thread'):
            self._stopping.set()
            self._thread.join(timeout=2.0)

    def teardown(self) -> None:
        self._close()
        if hasattr(self, '_preview'):
            self._preview.close()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        stream = self._stream
        lost = self._lost + (stream.lost if stream else 0)
        values: dict[str, object] = {
            'frames_published': self._published, 'frames_lost': lost,
            'frames_repeated': self._repeated + (stream.repeated if stream else 0),
            'longest_delay_ms': self._longest * 1e3}
        if stream:
            values |= {'size_px': f'{stream.format.width}×{stream.format.height}',
                       'clock': str(stream.format.clock)}
            if self.settings.exposure_ms > 0:
                values['exposure_ms'] = self.settings.exposure_ms
        since, self._told_lost = lost - self._told_lost, lost
        self._longest = 0.0
        if self._trouble:
            return ERROR, self._trouble, values
        if self._finished:
            return WARN, self._finished, values
        if since:
            return WARN, f'{since} frames lost since the last report', values
        return OK, f'publishing {self.settings.source}', values

    def _open(self) -> None:
        values = self.settings
        kind = camera_class(kind_of(values.camera, values.source))
        self._stream = FrameStream(kind(values, self.complain))
        self._set = values.exposure_ms, values.gain
        self._opened = time.monotonic()

    def _close(self) -> None:
        stream, self._stream = getattr(self, '_stream', None), None
        if stream:
            stream.close()
            self._lost += stream.lost
            self._repeated += stream.repeated

    def _run(self) -> None:
        try:
            while not (self._stopping.is_set() or self._finished):
                self._play()
        except Exception as error:
            self._failed('camera', error)
            self._trouble = f'stopped: {error}'
        finally:
            self._close()

    def _play(self) -> None:
        """Publish until the end, or until the device is lost; then try the device again."""
        try:
            if self._stream is None:
                self._open()
            while not self._stopping.is_set():
                if (self.settings.exposure_ms, self.settings.gain) != self._set:
                    self._close()
                    self._open()
                self._take()
        except EndOfFrames as end:
            self._close()
            if not self.settings.loop:
                self._finished = str(end)
                self.get_logger().info(self._finished)
        except InputError as error:
            self._trouble = f'{error}; reopening the same device'
            self.complain(self._trouble)
            self._close()
            self._stopping.wait(PATIENCE.reopen_s)

    def _take(self) -> None:
        assert self._stream is not None
        found = self._stream.read(_TURN_SECONDS)
        if found is None:
            return
        self._trouble = ''
        self._publish(*found)

    def _publish(self, frame: CameraFrame, exposed: float) -> None:
        assert self._stream is not None
        delay = time.monotonic() - exposed
        self._longest = max(self._longest, delay)
        stamp = messages.to_stamp(self.seconds() - delay)
        form = self._stream.format
        image = messages.image(frame.image, stamp, encoding=form.encoding)
        self._images.publish(image)
        self._preview.offer(image)
        if self._info.get_subscription_count():
            self._info.publish(messages.camera_info(form, stamp))
        self._published += 1
