"""First stage: from frames and the field to particles in the workspace."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.common.settings import setting
from microbot_ros.estimation.online.commands import NEGLIGIBLE
from microbot_ros.loop.points import PARTICLE
from microbot_ros.tracking import (
    Drive,
    FrameError,
    ImageToWorkspace,
    Poses,
    Tracker,
    TrackerSettings,
    warm_up,
)
from microbot_ros.tracking.link.doubt import together
from microbot_ros.tracking.locate.burnt_in import LEAST_FRAMES, burnt_in
from microbot_ros.tracking.locate.colour import Weights
from microbot_ros.tracking.teach import teacher

_HELD, _HELD_EVERY = 40, 0.1
"""Choice: frames kept for teaching, and the least time [s] between them (4 s in all)."""


@dataclass(frozen=True)
class TrackerParameters:
    """Parameters of the tracker."""

    pixel_size_um: float = setting(
        0.5, 'Width of a pixel in the sample.', lower=1e-3, upper=100.0, read_only=True)
    rotation_deg: float = setting(
        0.0, "Direction of the image's x axis in the workspace.", lower=-180.0, upper=180.0,
        read_only=True)
    mirrored: bool = setting(False, 'Whether the optics mirror the image.', read_only=True)
    settings_file: str = setting(
        '', 'YAML file with detection settings; empty: they are chosen from the first frames.',
        read_only=True)


class TrackerStage:
    """Positions, headings and identities of the particles, frame by frame.

    Raises InputError if the settings file of `parameters` cannot be read.

    Parameters
    ----------
    parameters : TrackerParameters
        Parameters of the tracker.
    """

    def __init__(self, parameters: TrackerParameters) -> None:
        warm_up()
        warm_up(np.uint16)
        file = parameters.settings_file
        self._parameters = parameters
        self._wanted = read_yaml(file, TrackerSettings) if file else TrackerSettings()
        self._tracker = Tracker(self._wanted)
        self._camera: ImageToWorkspace | None = None
        self._drive = Drive()
        self._previous = 0.0
        self._held: deque[tuple[float, np.ndarray]] = deque(maxlen=_HELD)
        self.poses: Poses | None = None
        """Poses found in the last frame, in its pixels."""
        self.frames = self.refused = 0
        self.longest_gap = 0.0
        """Longest time [s] between two frames since this was last set to 0."""

    @property
    def ready(self) -> bool:
        """Whether the appearance of the particles is known."""
        return self._tracker.ready

    @property
    def remarks(self) -> str:
        """Sentences about problems of the picture; '' if there are none."""
        return '; '.join(together(self._tracker.remarks.values()))

    def field(self, t: float, field: np.ndarray) -> None:
        """Let swimmers turn to a `field` (2,) [T] from `t` [s]; zero turns nothing.

        Parameters
        ----------
        t : float
            Time [s].
        field : ndarray, shape (2,)
            Field [T].
        """
        size = math.hypot(*field)
        if size >= NEGLIGIBLE:
            self._drive.command(t, field / size)

    def rotation(self, t: float, angular_velocity: np.ndarray) -> None:
        """Let rollers move along ω̂ × ẑ from `t` [s], `angular_velocity` (2,) [rad/s].

        Parameters
        ----------
        t : float
            Time [s].
        angular_velocity : ndarray, shape (2,)
            Angular velocity [rad/s].
        """
        x, y = angular_velocity
        self._drive.command(t, np.array([y, -x]) / math.tau)

    def step(self, image: np.ndarray, t: float) -> np.ndarray:
        """Return the particles (N,) of type PARTICLE in an `image` (H, W), exposed at `t` [s].

        Raises FrameError for an unusable image, which changes nothing.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        t : float
            Exposure of the picture [s].

        Returns
        -------
        ndarray, shape (N,)
            PARTICLE of each particle.
        """
        if self._camera is None:
            height, width = image.shape[:2]
            self._camera = ImageToWorkspace.of_tracker(vars(self._parameters), width, height)
        if self._wanted is not self._tracker.settings:
            self._tracker.teach(self._wanted)
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
        self._hold(image, t)
        return _particles(self.poses, self._camera)

    @property
    def colour(self) -> Weights | None:
        """Weights of red, green and blue for the conversion to grey; None: brightness."""
        return self._tracker.settings.colour

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the taught kinds of particles, as of the last frame."""
        return tuple(kind.name for kind in self._tracker.settings.kinds)

    def teach(self, like: bool, x: float, y: float, kind: str | None = None,
              stamp: float | None = None) -> str:
        """Learn from an example in a frame, from the next frame on.

        Another thread may process frames meanwhile.

        Parameters
        ----------
        like : bool
            Whether to follow such objects or to ignore them.
        x, y : float
            Position of the example [px].
        kind : str, optional
            Kind of the example, if it is to be followed.
        stamp : float, optional
            Exposure of the frame [s]; by default the newest frame.

        Returns
        -------
        str
            What was learned, in a sentence.

        Raises
        ------
        InputError
            If nothing can be learned from the example; nothing has changed then.
        """
        learn = teacher.like if like else teacher.unlike
        settings, said = learn(self._wanted, self._frame_at(stamp), x, y, kind)
        if like:
            # A taught place is no longer masked.
            settings = settings.replaced(standing=tuple(
                place for place in settings.standing if not place.holds(x, y)))
        self._wanted, more = self._masked(settings, x, y)
        return said + more

    def forget(self, kind: str | None = None) -> str:
        """Forget what was taught about a `kind`, or about all, and return a sentence on it.

        Raises InputError if there is nothing to forget.

        Parameters
        ----------
        kind : str or None
            Name of the kind; None for all.

        Returns
        -------
        str
            The sentence.
        """
        self._wanted, said = teacher.forget(self._wanted, kind)
        return said

    def pixel_at(self, x: float, y: float) -> tuple[float, float]:
        """Return the pixel (x, y) of a place (`x`, `y`) [m]; InputError before the first frame.

        Parameters
        ----------
        x, y : float
            Place in the workspace [m].

        Returns
        -------
        tuple[float, float]
            Pixel (x, y).
        """
        if self._camera is None:
            raise InputError('teach', 'no frame to point into yet; start the camera')
        column, row = self._camera.pixels(np.array([x, y]))
        return float(column), float(row)

    def _masked(
        self, settings: TrackerSettings, x: float, y: float
    ) -> tuple[TrackerSettings, str]:
        """Return settings that mask burnt-in overlays, but none at (x, y), and a message."""
        held = [image for _, image in list(self._held)[-LEAST_FRAMES:]]
        places = tuple(place for place in burnt_in(held, settings.kinds)
                       if not place.holds(x, y)
                       and not any(known.holds(place.x_px, place.y_px)
                                   for known in settings.standing))
        if not places:
            return settings, ''
        where = ' '.join(f'{place.x_px:.0f},{place.y_px:.0f}' for place in places)
        return (settings.replaced(standing=(*settings.standing, *places)),
                f'; left out as burnt into the picture: what is at {where}')

    def with_kinds(self, particles: np.ndarray) -> np.ndarray:
        """Return the last frame's `particles` (N,) with a field `kind`, an index into `kinds`.

        Without taught kinds they are returned unchanged.

        Parameters
        ----------
        particles : ndarray, shape (N,)
            PARTICLE of each particle.

        Returns
        -------
        ndarray, shape (N,)
            Particles, with `kind` if kinds were taught.
        """
        if not self.kinds or self.poses is None:
            return particles
        wide = np.empty(len(particles), [*PARTICLE.descr, ('kind', '<f4')])
        for name in PARTICLE.names or ():
            wide[name] = particles[name]
        wide['kind'] = self.poses.kind
        return wide

    def _hold(self, image: np.ndarray, t: float) -> None:
        """Keep a frame now and then, because users point at what they saw a moment ago."""
        self._newest = t, image
        if not (self._held and 0 <= t - self._held[-1][0] < _HELD_EVERY):
            self._held.append((t, image.copy()))

    def _frame_at(self, stamp: float | None) -> np.ndarray:
        """Return the frame of a `stamp` [s] or the nearest one kept; None: the newest."""
        held = list(self._held)  # a copy: another thread may add frames
        if not held:
            raise InputError('teach', 'no frame to point into yet; start the camera')
        last, newest = self._newest
        if stamp is None or stamp == last:
            return newest
        t, image = min(held, key=lambda frame: abs(frame[0] - stamp))
        if abs(t - stamp) > _HELD_EVERY:
            raise InputError('teach', 'expected a frame of the last few seconds: that one is no '
                                      'longer held')
        return image


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
