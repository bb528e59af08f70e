"""Node `tracker`: particles and their identities from frames, in metres."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseArray, Vector3Stamped
from sensor_msgs.msg import Image, MagneticField, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from microbot_ros.common import units
from microbot_ros.common.errors import InputError, clipped
from microbot_ros.common.settings import setting
from microbot_ros.loop.tracker import TrackerParameters, TrackerStage
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.core import Core
from microbot_ros.nodes.base.felt_rotation import follow_rotation
from microbot_ros.nodes.base.frames import publish_camera_transform
from microbot_ros.nodes.base.lifecycle import (
    IMAGES_IN,
    IMAGES_OUT,
    LATCHED,
    OK,
    SILENCE_SECONDS,
    WARN,
    RigNode,
)
from microbot_ros.tracking import FrameError


@dataclass(frozen=True)
class TrackerNodeParameters(TrackerParameters):
    """Parameters of the node `tracker`."""

    field_source: str = setting(
        'applied', 'Source of the turning of the particles, to predict it: the measured field, '
                   'the commanded field, the rotation of rollers while a field is measured, or '
                   'none.',
        choices=('applied', 'command', 'rotation', 'none'), read_only=True)
    example_kind: str = setting(
        '', 'Kind of the next example on `tracker/like` or `tracker/unlike`, and the kind that '
            '`tracker/forget` removes; empty: the kind that fits best, and all kinds.')
    overlay_rate_hz: float = setting(
        10.0, 'Rate of `overlay/image_raw` while it has subscribers; 0 disables it.',
        lower=0.0, upper=60.0)
    poses_rate_hz: float = setting(
        10.0, 'Rate of `particles/poses`, for viewers.', lower=0.0, upper=60.0)


class TrackerCore(Core):
    """Core between `camera/image_raw`, the field and `particles`, `particles/poses`."""

    Parameters: ClassVar[type] = TrackerNodeParameters
    frame = 'camera/image_raw'

    def connect(self) -> None:
        self.stage = TrackerStage(self.settings)
        self._due = {'poses': 0.0, 'overlay': 0.0}
        self._particles = self.publisher(PointCloud2, 'particles')
        self._poses = self.publisher(PoseArray, 'particles/poses')
        source = self.settings.field_source
        if source == 'applied':
            self.subscribe(MagneticField, 'field/applied', self._on_applied)
        elif source == 'command':
            self.subscribe(Vector3Stamped, 'field/command', self._on_command)
        elif source == 'rotation':
            follow_rotation(self, self.stage.rotation)
        self.subscribe(Image, 'camera/image_raw', self._on_image, IMAGES_IN)

    def seen(self, image: np.ndarray, stamp: Time) -> None:
        """Do nothing; called after the particles of each frame are published.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The frame.
        stamp : Time
            Stamp of the message.
        """

    def _on_image(self, message: Image) -> None:
        image = messages.gray(message, self.stage.colour)
        stamp = message.header.stamp
        t = messages.to_seconds(stamp)
        try:
            particles = self.stage.step(image, t)
        except FrameError as error:
            self.complain(str(error))
            return
        self._particles.publish(messages.cloud(self.stage.with_kinds(particles), stamp))
        if self.is_due('poses', self.settings.poses_rate_hz, t):
            places = np.stack([particles['x'], particles['y']], axis=1)
            self._poses.publish(messages.poses(places, particles['theta'], stamp))
        self.seen(image, stamp)

    def is_due(self, what: str, rate: float, t: float) -> bool:
        """Return whether a periodic publication is due.

        Parameters
        ----------
        what : str
            Its name.
        rate : float
            Its rate [Hz]; 0 for never.
        t : float
            Time of the frame [s].

        Returns
        -------
        bool
            Whether it is due.
        """
        if rate <= 0 or (t < self._due[what] and self._due[what] - t < 10.0):
            return False
        self._due[what] = t + 1 / rate
        return True

    def _on_applied(self, message: MagneticField) -> None:
        self.stage.field(*messages.field_at(message))

    def _on_command(self, message: Vector3Stamped) -> None:
        self.stage.field(*messages.vector_at(message))


class TrackerNode(RigNode, TrackerCore):
    """Node with a `TrackerCore`.

    It also publishes `overlay/image_raw`, the names of the taught kinds on `tracker/kinds`, and
    the place of the picture on `/tf_static`. It receives examples on `tracker/like` and
    `tracker/unlike`; `tracker/taught` reports the result of each.
    """

    def setup(self) -> None:
        self._came = -float('inf')
        self._told_kinds: tuple[str, ...] | None = None
        self._overlay = self.publisher(Image, 'overlay/image_raw', IMAGES_OUT)
        self._names = self.publisher(String, '~/kinds', LATCHED)
        publish_camera_transform(
            self, units.to_si('rotation_deg', self.settings.rotation_deg), self.settings.mirrored)
        self._taught = self.publisher(DiagnosticStatus, '~/taught', LATCHED)
        aside = self.aside('teach')  # learning takes longer than a frame
        self.subscribe(PointStamped, '~/like',
                       lambda example: aside(lambda: self._learn('like', example)))
        self.subscribe(PointStamped, '~/unlike',
                       lambda example: aside(lambda: self._learn('unlike', example)))
        self.service(Trigger, '~/forget', self._on_forget)
        self.connect()
        self._tell_kinds()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        stage, silence = self.stage, time.monotonic() - self._came
        count = len(stage.poses) if stage.poses is not None else 0
        values: dict[str, object] = {
            'frames': stage.frames, 'frames_refused': stage.refused, 'particles': count,
            'longest_gap_s': stage.longest_gap, 'silence_s': silence}
        stage.longest_gap = 0.0
        if silence > SILENCE_SECONDS:
            since = f' for {silence:.0f} s' if stage.frames else ''
            return WARN, f'no frames on camera/image_raw{since}', values
        if not stage.ready:
            return OK, 'learning what particles look like', values
        return OK, f'tracking {count} particles', values

    def seen(self, image: np.ndarray, stamp: Time) -> None:
        if remarks := self.stage.remarks:
            self.complain(remarks)
        self._came = time.monotonic()
        self._tell_kinds()
        if self._overlay.get_subscription_count() and self.is_due(
                'overlay', self.settings.overlay_rate_hz, messages.to_seconds(stamp)):
            self._draw(image, stamp)

    def _learn(self, example: str, message: PointStamped) -> None:
        """Learn from an example and publish the result on `tracker/taught`."""
        header, point = message.header, message.point
        try:
            if not math.isfinite(point.x + point.y):
                raise InputError(f'tracker/{example}', 'expected finite coordinates; received '
                                 f'{point.x}, {point.y}')
            if header.frame_id == messages.WORKSPACE:
                x, y = self.stage.pixel_at(point.x, point.y)
            elif header.frame_id == messages.PIXELS:
                x, y = point.x, point.y
            else:
                raise InputError(f'tracker/{example}', f"expected the frame {messages.PIXELS} or "
                                 f"{messages.WORKSPACE}; received '{clipped(header.frame_id)}'")
            level, said = OK, self.stage.teach(
                example == 'like', x, y, self.settings.example_kind or None,
                messages.to_seconds(header.stamp) or None)
        except InputError as error:
            level, said = WARN, str(error)
        self._taught.publish(DiagnosticStatus(
            level=level, name='tracker/taught', message=said, values=[
                KeyValue(key=key, value=str(value)) for key, value in (
                    ('example', example), ('stamp_ns', messages.to_nanoseconds(header.stamp)),
                    ('x', point.x), ('y', point.y))]))

    def _on_forget(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        """Delete the kind that `example_kind` names, or all kinds."""
        try:
            answer.message = self.stage.forget(self.settings.example_kind or None)
            answer.success = True
        except InputError as error:
            answer.message, answer.success = str(error), False
        return answer

    def _tell_kinds(self) -> None:
        if self.stage.kinds != self._told_kinds:
            self._told_kinds = self.stage.kinds
            self._names.publish(String(data=json.dumps(self._told_kinds)))

    def _draw(self, image: np.ndarray, stamp: Time) -> None:
        from microbot_ros.tracking.overlay import draw_overlay

        assert self.stage.poses is not None
        self._overlay.publish(messages.image(draw_overlay(image, self.stage.poses), stamp))
