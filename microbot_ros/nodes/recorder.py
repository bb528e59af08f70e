"""Node `recorder`: every topic of the graph to an MCAP recording, as it came off the wire."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, Vector3Stamped
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, JointState, MagneticField, PointCloud2, TimeReference
from visualization_msgs.msg import MarkerArray

from microbot_ros.errors import InputError
from microbot_ros.nodes.lifecycle import IMAGES_IN, OK, WARN, RigNode
from microbot_ros.session import RecordingWriter
from microbot_ros.settings import setting

_DEEP = QoSProfile(depth=100)

TOPICS: dict[str, tuple[type, QoSProfile]] = {
    'camera/image_raw': (Image, IMAGES_IN),
    'overlay/image_raw': (Image, IMAGES_IN),
    'particles': (PointCloud2, _DEEP),
    'particles/poses': (PoseArray, _DEEP),
    'model/state': (PointCloud2, _DEEP),
    'goal_pose': (PoseStamped, _DEEP),
    'goals': (PoseArray, _DEEP),
    'path': (PathMessage, _DEEP),
    'field/command': (Vector3Stamped, _DEEP),
    'field/rotation': (Vector3Stamped, _DEEP),
    'field/applied': (MagneticField, _DEEP),
    'coils/command': (JointState, _DEEP),
    'coils/applied': (JointState, _DEEP),
    'coils/measured': (JointState, _DEEP),
    'coil_driver/latency': (TimeReference, _DEEP),
    'virtual_rig/truth': (PointCloud2, _DEEP),
    'markers': (MarkerArray, _DEEP),
    '/diagnostics': (DiagnosticArray, _DEEP),
}
"""What is recorded, where it is published at all."""

_FRAMES = 'camera/image_raw'
_CONDITIONS = ('propulsion', 'radius_um', 'viscosity_mPa_s', 'temperature_K')
"""Parameters of the node `model` that a session keeps."""


@dataclass(frozen=True)
class RecorderParameters:
    """Parameters of the node `recorder`."""

    folder: str = setting(
        '', 'Folder of the recording; empty makes one in ./recordings named after the time.',
        read_only=True)
    frame_every: int = setting(
        1, 'Record every n-th camera frame; 0 records none.', lower=0, upper=1000)
    record_overlay: bool = setting(False, 'Record `overlay/image_raw` too.', read_only=True)
    title: str = setting('', 'One line on what the recording is of.', read_only=True)
    attachments: list[str] = setting(
        [], 'Files kept inside the recording: rig, model, protocol.', read_only=True)


class RecorderNode(RigNode):
    """Hands serialised messages to the writer, whose own thread compresses and writes."""

    Parameters: ClassVar[type] = RecorderParameters

    def setup(self) -> None:
        self._writer: RecordingWriter | None = None
        self._attachments = {}
        for name in self.settings.attachments:
            try:
                self._attachments[Path(name).name] = Path(name).read_bytes()
            except OSError as error:
                raise InputError(name, f'expected a file to attach ({error.strerror})') from None
        for topic, (kind, qos) in TOPICS.items():
            if topic != 'overlay/image_raw' or self.settings.record_overlay:
                self.subscribe(kind, topic, self._taker(topic, kind), qos, raw=True)

    def start(self) -> None:
        folder = self.settings.folder or f'recordings/{datetime.now():%Y-%m-%d_%H-%M-%S}'
        Path(folder).parent.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._seen_frames = 0
        self._writer = RecordingWriter(folder)
        offset = self.get_clock().now().nanoseconds - time.monotonic_ns()
        self._writer.describe('recording', {
            'title': self.settings.title, 'ros_minus_monotonic_ns': str(offset)})
        self._writer.describe('versions', {
            name: metadata.version(name) for name in ('microbot_ros', 'numpy')})
        for name, content in self._attachments.items():
            self._writer.attach(name, content)
        self._described = False
        self._model = self.client(GetParameters, 'model/get_parameters')
        self.every(0.5, self._ask_for_conditions)

    def _ask_for_conditions(self) -> None:
        """Once the model node is there: what it was told of particles and fluid."""
        if self._described or not self._model.service_is_ready():
            return
        self._described = True
        asked = self._model.call_async(GetParameters.Request(names=list(_CONDITIONS)))
        asked.add_done_callback(self._describe)

    def _describe(self, answered: Any) -> None:
        values = [parameter_value_to_python(value) for value in answered.result().values]
        if self._writer is not None:
            self._writer.describe('session', {
                name: str(value) for name, value in zip(_CONDITIONS, values, strict=True)})

    def stop(self) -> None:
        if getattr(self, '_writer', None):
            writer, self._writer = self._writer, None
            assert writer is not None
            writer.close()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        assert self._writer is not None
        status = self._writer.status()
        values: dict[str, object] = {
            'messages': sum(status.counts.values()), 'dropped': sum(status.dropped.values()),
            'written_MB': status.bytes_written / 1e6, 'queued_MB': status.queued_bytes / 1e6,
            'free_GB': status.free_bytes / 1e9}
        if status.problem:
            return WARN, status.problem, values
        return OK, f'recording to {self._folder}', values

    def _taker(self, topic: str, kind: type) -> Callable[[bytes], None]:
        name = self.resolve_topic_name(topic)
        package = kind.__module__.partition('.')[0]
        type_name = f'{package}/msg/{kind.__name__}'

        def take(data: bytes) -> None:
            assert self._writer is not None
            if topic == _FRAMES and not self._wants_frame():
                return
            self._writer.write(name, type_name, self.get_clock().now().nanoseconds, data)
        return take

    def _wants_frame(self) -> bool:
        self._seen_frames += 1
        every = self.settings.frame_every
        return every > 0 and self._seen_frames % every == 0
