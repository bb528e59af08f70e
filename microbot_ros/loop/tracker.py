"""First stage: frames and the field → particles in the workspace."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros import units
from microbot_ros.estimation.commands import NEGLIGIBLE
from microbot_ros.files import read_yaml
from microbot_ros.loop.points import PARTICLE
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
    """Parameters of the tracker."""

    pixel_size_um: float = setting(
        0.5, 'Width of a pixel in the sample.', lower=1e-3, upper=100.0, read_only=True)
    rotation_deg: float = setting(
        0.0, "Direction of the image's x axis in the workspace.", lower=-180.0, upper=180.0,
        read_only=True)
    mirrored: bool = setting(False, 'The optics mirror the picture.', read_only=True)
    settings_file: str = setting(
        '', 'YAML file with settings of the detection; empty chooses them from the first frames.',
        read_only=True)
    full_search_ms: float = setting(
        100.0, 'Longest time between searches of the whole picture, and so until a new particle '
        'is seen; known ones are looked for around their predictions. 0: every frame.',
        lower=0.0, upper=10_000.0, read_only=True)


class TrackerStage:
    """Positions, headings and identities of the particles, from one frame after the other.

    Raises InputError where `parameters` name a settings file that cannot be read.
    """

    def __init__(self, parameters: TrackerParameters) -> None:
        warm_up()
        file = parameters.settings_file
        self._parameters = parameters
        self._tracker = Tracker(
            read_yaml(file, TrackerSettings) if file else TrackerSettings(),
            full_search_interval=units.to_si('full_search_ms', parameters.full_search_ms))
        self._camera: ImageToWorkspace | None = None
        self._drive = Drive()
        self._previous = 0.0
        self.poses: Poses | None = None
        """What was seen in the last frame, in its pixels."""
        self.frames = self.refused = 0
        self.longest_gap = 0.0
        """Longest time [s] between two frames since somebody set this to 0."""

    @property
    def ready(self) -> bool:
        """Whether it knows what particles look like."""
        return self._tracker.ready

    @property
    def remarks(self) -> str:
        """What is wrong with the picture, in words; '' where nothing is."""
        return '; '.join(self._tracker.remarks.values())

    def field(self, t: float, field: np.ndarray) -> None:
        """From `t` [s] on swimmers turn with a field (2,) [T]; without one they go on."""
        size = math.hypot(*field)
        if size >= NEGLIGIBLE:
            self._drive.command(t, field / size)

    def rotation(self, t: float, angular_velocity: np.ndarray) -> None:
        """From `t` [s] on rollers roll along ω̂ × ẑ, for an angular velocity (2,) [rad/s]."""
        x, y = angular_velocity
        self._drive.command(t, np.array([y, -x]) / math.tau)

    def step(self, image: np.ndarray, t: float) -> np.ndarray:
        """The particles (N,) of type PARTICLE in an `image` (H, W), exposed at `t` [s].

        Raises FrameError for a picture that cannot be used; nothing has changed then.
        """
        if self._camera is None:
            self._camera = self._calibration(image)
        drive = self._drive.between(self._previous, t) if self.frames else np.zeros(2)
        try:
            self.poses = self._tracker.update(image, t, self._camera.image_axes(drive))
        except FrameError:
            self.refused += 1
            raise
        if self.frames:
            self.longest_gap = max(self.longest_gap, t - self._previous)
        self._previous = t
        self.frames += 1
        return _particles(self.poses, self._camera)

    def _calibration(self, image: np.ndarray) -> ImageToWorkspace:
        values = self._parameters
        return ImageToWorkspace(
            pixel_size=units.to_si('pixel_size_um', values.pixel_size_um),
            width=image.shape[1], height=image.shape[0], mirrored=values.mirrored,
            rotation=units.to_si('rotation_deg', values.rotation_deg))


def _particles(poses: Poses, camera: ImageToWorkspace) -> np.ndarray:
    rows = np.empty((len(poses), PARTICLE.itemsize // 4), '<f4')
    rows[:, 1:3] = camera.position(poses.xy)
    # A Janus particle swims with its cap behind.
    rows[:, 3] = camera.angle(poses.theta_rad + math.pi)
    rows[:, 4:6] = camera.vector(poses.velocity)
    rows[:, 6] = poses.sigma_px * camera.pixel_size
    points = rows.view(PARTICLE)[:, 0]
    points['id'] = poses.id
    return points
