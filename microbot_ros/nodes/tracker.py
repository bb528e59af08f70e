"""Node `tracker`: particles and their identities from frames, in metres."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseArray, Vector3Stamped
from sensor_msgs.msg import Image, MagneticField, PointCloud2

from microbot_ros import units
from microbot_ros.estimation.commands import NEGLIGIBLE
from microbot_ros.files import read_yaml
from microbot_ros.nodes import messages
from microbot_ros.nodes.lifecycle import (
    IMAGES_IN,
    IMAGES_OUT,
    OK,
    SILENCE_SECONDS,
    WARN,
    RigNode,
)
from microbot_ros.settings import setting
from microbot_ros.tracking import (
    Drive,
    FrameError,
    ImageToWorkspace,
    Poses,
    Tracker,
    TrackerSettings,
    warm_up,
)


@dataclass(frozen=True)
class TrackerParameters:
    """Parameters of the node `tracker`."""

    pixel_size_um: float = setting(
        0.5, 'Width of a pixel in the sample.', lower=1e-3, upper=100.0, read_only=True)
    rotation_deg: float = setting(
        0.0, "Direction of the image's x axis in the workspace.", lower=-180.0, upper=180.0,
        read_only=True)
    mirrored: bool = setting(False, 'The optics mirror the picture.', read_only=True)
    settings_file: str = setting(
        '', 'YAML file with settings of the detection; empty chooses them from the first frames.',
        read_only=True)
    field_source: str = setting(
        'applied', 'What turns the particles, so that a turn is expected: the field read back '
        'from the coils, the one commanded, the rotation of rollers, or nothing known.',
        choices=('applied', 'command', 'rotation', 'none'), read_only=True, formerly='drive')
    full_search_ms: float = setting(
        100.0, 'Longest time between searches of the whole picture, and so until a new particle '
        'is seen; known ones are looked for around their predictions. 0: every frame.',
        lower=0.0, upper=10_000.0, read_only=True)
    overlay_rate_hz: float = setting(
        10.0, 'Rate of `overlay/image_raw` while somebody looks; 0 turns it off.',
        lower=0.0, upper=60.0)
    poses_rate_hz: float = setting(
        10.0, 'Rate of `particles/poses`, for viewers.', lower=0.0, upper=60.0)


class TrackerNode(RigNode):
    """`camera/image_raw` and the field → `particles`, `particles/poses`, `overlay/image_raw`."""

    Parameters: ClassVar[type] = TrackerParameters
    accounts_for = 'camera/image_raw'

    def setup(self) -> None:
        warm_up()
        file = self.settings.settings_file
        self._tracker = Tracker(
            read_yaml(file, TrackerSettings) if file else TrackerSettings(),
            full_search_interval=units.to_si(
                'full_search_ms', self.settings.full_search_ms))
        self._camera: ImageToWorkspace | None = None
        self._frames = self._refused = self._count = 0
        self._previous = self._longest_gap = 0.0
        self._came = -math.inf
        self._due = {'poses': 0.0, 'overlay': 0.0}
        self._particles = self.publisher(PointCloud2, 'particles')
        self._poses = self.publisher(PoseArray, 'particles/poses')
        self._overlay = self.publisher(Image, 'overlay/image_raw', IMAGES_OUT)
        self._drive = Drive()
        self._listen(self.settings.field_source)
        self.subscribe(Image, 'camera/image_raw', self._on_image, IMAGES_IN)

    def _listen(self, source: str) -> None:
        if source == 'applied':
            self.subscribe(MagneticField, 'field/applied', self._on_applied)
        elif source == 'command':
            self.subscribe(Vector3Stamped, 'field/command', self._on_command)
        elif source == 'rotation':
            self.subscribe(Vector3Stamped, 'field/rotation', self._on_rotation)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        silence = time.monotonic() - self._came
        values: dict[str, object] = {
            'frames': self._frames, 'frames_refused': self._refused,
                  'particles': self._count, 'longest_gap_s': self._longest_gap,
                  'silence_s': silence}
        self._longest_gap = 0.0
        if silence > SILENCE_SECONDS:
            since = f' for {silence:.0f} s' if self._frames else ''
            return WARN, f'no frames on camera/image_raw{since}', values
        if not self._tracker.ready:
            return OK, 'learning what particles look like', values
        return OK, f'tracking {self._count} particles', values

    def _on_image(self, message: Image) -> None:
        image = messages.gray(message)
        t = messages.to_seconds(message.header.stamp)
        if self._camera is None:
            self._camera = self._calibration(image)
        drive = self._drive.between(self._previous, t) if self._frames else np.zeros(2)
        try:
            poses = self._tracker.update(image, t, self._camera.image_axes(drive))
        except FrameError as error:
            self._refused += 1
            self.complain(str(error))
            return
        if self._tracker.remarks:
            self.complain('; '.join(self._tracker.remarks.values()))
        if self._frames:
            self._longest_gap = max(self._longest_gap, t - self._previous)
        self._previous, self._came = t, time.monotonic()
        self._frames += 1
        self._count = len(poses)
        self._publish(image, poses, self._camera, message.header.stamp)

    def _on_applied(self, message: MagneticField) -> None:
        field = message.magnetic_field
        self._swim(message, field.x, field.y)

    def _on_command(self, message: Vector3Stamped) -> None:
        self._swim(message, message.vector.x, message.vector.y)

    def _swim(self, message: MagneticField | Vector3Stamped, x: float, y: float) -> None:
        messages.in_workspace(message.header)
        size = math.hypot(x, y)
        if size >= NEGLIGIBLE:  # without a field, particles go on as they were
            self._drive.command(
                messages.to_seconds(message.header.stamp), np.array([x, y]) / size)

    def _on_rotation(self, message: Vector3Stamped) -> None:
        """A field that turns with ω rolls particles along ω̂ × ẑ."""
        messages.in_workspace(message.header)
        turns = np.array([message.vector.y, -message.vector.x]) / math.tau
        self._drive.command(messages.to_seconds(message.header.stamp), turns)

    def _calibration(self, image: np.ndarray) -> ImageToWorkspace:
        return ImageToWorkspace(
            pixel_size=units.to_si('pixel_size_um', self.settings.pixel_size_um),
            width=image.shape[1], height=image.shape[0], mirrored=self.settings.mirrored,
            rotation=units.to_si('rotation_deg', self.settings.rotation_deg))

    def _publish(self, image: np.ndarray, poses: Poses, camera: ImageToWorkspace,
                 stamp: Time) -> None:
        points = np.empty(len(poses), messages.PARTICLE)
        position, velocity = camera.position(poses.xy), camera.vector(poses.velocity)
        points['id'] = poses.id
        points['x'], points['y'] = position.T
        points['vx'], points['vy'] = velocity.T
        # A Janus particle swims with its cap behind.
        points['theta'] = camera.angle(poses.theta_rad + math.pi)
        points['sigma'] = poses.sigma_px * camera.pixel_size
        self._particles.publish(messages.cloud(points, stamp))
        if self._is_due('poses', self.settings.poses_rate_hz, poses.t):
            self._poses.publish(messages.poses(position, points['theta'], stamp))
        if self._overlay.get_subscription_count() and self._is_due(
                'overlay', self.settings.overlay_rate_hz, poses.t):
            from microbot_ros.tracking.overlay import draw_overlay

            self._overlay.publish(messages.image(draw_overlay(image, poses), stamp))

    def _is_due(self, what: str, rate: float, t: float) -> bool:
        if rate <= 0 or (t < self._due[what] and self._due[what] - t < 10.0):
            return False
        self._due[what] = t + 1 / rate
        return True
