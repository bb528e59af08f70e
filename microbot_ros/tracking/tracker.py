"""The tracker: frames in, poses with lasting identities out."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.errors import InputError
from microbot_ros.tracking.frame_quality import FrameQuality
from microbot_ros.tracking.link.linker import Linker
from microbot_ros.tracking.link.states import PLACE, VELOCITY, VELOCITY_PHASOR, TrackStates
from microbot_ros.tracking.locate.detect import RoundDetector
from microbot_ros.tracking.locate.kinds_detector import KindsDetector, stand_in
from microbot_ros.tracking.locate.outline import OutlineDetector
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.settings import TrackerSettings
from microbot_ros.tracking.teach.learn import learning

LEAST_PX = 12
"""Smallest side of a picture [px].

Choice: four times the smallest diameter; the illumination cannot be told from less.
"""


class FrameError(InputError):
    """A frame that cannot be used: wrong size, encoding or time. The tracker is unchanged.

    `expected` says what would have been right.

    Parameters
    ----------
    expected : str
        What would have been right.
    """

    def __init__(self, expected: str) -> None:
        super().__init__('frame', expected)


@dataclass(frozen=True)
class Poses:
    """Poses of N particles at time `t` [s]; seen positions are measurements, not smoothed.

    Attributes
    ----------
    id : (N,) int array
        Lasting identities, never reused.
    x_px, y_px : (N,) array
        Image coordinates, y down, the centre of the first pixel at (0, 0).
    theta_rad : (N,) array
        Direction of the cap from the image's x towards its y (clockwise on the screen), or of the
        tail of elongated bodies, opposite to their average motion; NaN if unknown.
    vx_px_s, vy_px_s : (N,) array
    sigma_px : (N,) array
        Standard deviation of each coordinate, growing while unseen, and while the identity is in
        doubt, which `Tracker.remarks` reports.
    seen : (N,) bool array
        False while a particle is predicted only.
    kind : (N,) int array
        Index of the taught kind, 0 if there are none.
    """

    t: float
    id: np.ndarray
    x_px: np.ndarray
    y_px: np.ndarray
    theta_rad: np.ndarray
    vx_px_s: np.ndarray
    vy_px_s: np.ndarray
    sigma_px: np.ndarray
    seen: np.ndarray
    kind: np.ndarray

    def __len__(self) -> int:
        return len(self.id)

    @property
    def xy(self) -> np.ndarray:
        """Positions (N, 2) [px]."""
        return np.array([self.x_px, self.y_px]).T.copy()

    @property
    def velocity(self) -> np.ndarray:
        """Velocities (N, 2) [px/s]."""
        return np.array([self.vx_px_s, self.vy_px_s]).T.copy()


class Tracker:
    """Finds and follows particles in a stream of frames, by `settings`.

    Without an `appearance` one is learned from the first frames in which something stands out, a
    portion with each further frame; until then `ready` is False and there are no poses. OpenCV is
    limited to one thread, since the tracker shares its machine with the rest of the loop.

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    appearance : Appearance or None
        The learned picture; None to learn it.
    """

    def __init__(
        self, settings: TrackerSettings, appearance: Appearance | None = None,
    ) -> None:
        import cv2

        cv2.setNumThreads(1)
        self.settings = settings
        self.appearance = stand_in(settings.kinds) if settings.kinds else appearance
        self.size: tuple[int, int] | None = None
        self._dtype: np.dtype | None = None
        self._follower: _Follower | None = None
        self._first_frames: list[np.ndarray] = []
        self._learning: Generator[None, None, Appearance | None] | None = None
        self.remarks: dict[str, str] = {}
        """Visible problems of the last frame: kind → sentence."""
        self._frame_quality = FrameQuality()
        self._last = -math.inf
        self._refused = -math.inf

    @property
    def ready(self) -> bool:
        """Whether the appearance of the particles is known."""
        return self.appearance is not None

    @property
    def before_named(self) -> tuple[np.ndarray, np.ndarray]:
        """Ids (n,) and earlier positions (n, K, 2) [px] of particles named in the last frame.

        In the K = confirm_frames − 1 frames before, oldest first.
        """
        if self._follower is None:
            return np.empty(0, int), np.empty((0, self.settings.confirm_frames - 1, 2))
        named = self._follower.linker.named
        return named.id, named.early

    def teach(self, settings: TrackerSettings) -> None:
        """Continue with other `settings`; particles that are found again keep their identities.

        Particles of a removed kind are dropped.

        Parameters
        ----------
        settings : TrackerSettings
            Settings of the tracker.
        """
        if self._follower is not None:
            names = [kind.name for kind in settings.kinds]
            self._follower.linker.renumber_kinds(np.array([
                names.index(kind.name) if kind.name in names else -1
                for kind in self.settings.kinds] or [0 if names else -1]))
        self.settings = settings
        self._learning, self._first_frames = None, []
        self.appearance = stand_in(settings.kinds) if settings.kinds else None
        self._look()

    def _look(self) -> None:
        """Search from now on by the present settings and appearance."""
        if self._follower is not None and self.appearance is not None:
            self._follower.look_for(self.settings, self.appearance)

    def update(
        self, image: np.ndarray, t: float, drive: np.ndarray | None = None
    ) -> Poses:
        """Return the poses at time `t` [s] from a frame `image` (H, W) of uint8 or uint16.

        `drive` (2,) is the direction in which the field drives particles, in image axes,
        integrated since the last frame (`Drive.between`); the response of each particle to it is
        learned. Raises FrameError, without any change, for a frame of another kind than the first
        or a time that is not later. If the clock was set back for good, the next frame continues
        from there, identities kept.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        t : float
            Time of the frame [s].
        drive : ndarray, shape (2,), or None
            Integrated drive in image axes; None for none.

        Returns
        -------
        Poses
            The poses.
        """
        self._check(image, drive)
        image = np.ascontiguousarray(image)  # a view would compile everything again
        dt = self._interval(t)
        self.size, self._dtype = image.shape, image.dtype
        if self.appearance is None:
            self.remarks = self._frame_quality.look(image, dt, 0.0)
            self._learn(image)
            return _poses(t, None, 0j)
        if self._follower is None:
            self._follower = _Follower(self.settings, self.appearance, image.shape)
        pushed = 0j if drive is None else complex(*drive)
        self._follower.follow(image, dt, pushed)
        linker = self._follower.linker
        self.remarks = self._frame_quality.look(image, dt, linker.jump) | linker.doubts
        if self._follower.detector.remark:
            self.remarks['strange'] = self._follower.detector.remark
        return _poses(t, linker.states, pushed / dt if dt else 0j)

    def _check(self, image: np.ndarray, drive: np.ndarray | None) -> None:
        if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16) or image.size == 0:
            raise FrameError(
                f'expected (H, W) grey uint8 or uint16; received {image.shape} {image.dtype}')
        if min(image.shape) < LEAST_PX:
            raise FrameError(f'expected at least {LEAST_PX}×{LEAST_PX} pixels; received '
                             f'{image.shape[1]}×{image.shape[0]}')
        if self.size is not None and (image.shape != self.size or image.dtype != self._dtype):
            raise FrameError(
                f'expected {self.size[1]}×{self.size[0]} {self._dtype} as before; received '
                f'{image.shape[1]}×{image.shape[0]} {image.dtype}')
        if drive is not None and not (
                np.shape(drive) == (2,) and all(map(math.isfinite, drive))):
            raise FrameError(f'expected a finite field (2,); received {drive}')

    def _interval(self, t: float) -> float | None:
        """Return the time since the last frame [s]; None for the first."""
        if not math.isfinite(t):
            raise FrameError(f'expected a finite time stamp; received {t}')
        if t > self._last:
            dt = t - self._last if math.isfinite(self._last) else None
        elif t > self._refused and math.isfinite(self._refused):
            dt = t - self._refused
        else:
            self._refused = t
            kind = 'the same as' if t == self._last else f'{self._last - t:g} s before'
            raise FrameError(f'expected a later time stamp; {t:g} s is {kind} the last one')
        self._last, self._refused = t, -math.inf
        return dt

    def _learn(self, image: np.ndarray) -> None:
        """Collect the first frames, then learn a portion with each further one."""
        if self._learning is None:
            self._first_frames.append(image.copy())
            if len(self._first_frames) == self.settings.learning_frames:
                self._learning = learning(self._first_frames, self.settings)
                self._first_frames = []
            return
        try:
            next(self._learning)
        except StopIteration as done:
            self.appearance = done.value
            self._learning = None
            self._look()


class _Follower:
    """Search, fit and linking, once the appearance of particles is known."""

    def __init__(self, settings: TrackerSettings, appearance: Appearance, size: tuple[int, int],
                 ) -> None:
        self.linker = Linker(settings, appearance, size)
        self.look_for(settings, appearance)

    def look_for(self, settings: TrackerSettings, appearance: Appearance) -> None:
        """Search by these `settings` and `appearance`; continue with known particles."""
        self.detector = make_detector(appearance, settings)
        self.linker.look_for(settings, appearance)

    def follow(self, image: np.ndarray, dt: float | None, pushed: complex) -> None:
        """Follow all particles to the picture (H, W), `dt` [s] after the last."""
        if dt is not None:
            self.linker.predict(dt, pushed)
        self.linker.update(self.detector.detect(image, self.linker.expected()))


Detector = RoundDetector | OutlineDetector | KindsDetector
"""Finds particles in a picture: one look, one outline, or kinds of bodies."""


def make_detector(appearance: Appearance, settings: TrackerSettings) -> Detector:
    """Return the detector for the `appearance`, or for the kinds in the `settings`.

    Parameters
    ----------
    appearance : Appearance
        The learned picture.
    settings : TrackerSettings
        Settings of the tracker.

    Returns
    -------
    RoundDetector or OutlineDetector or KindsDetector
        The detector.
    """
    if settings.kinds:
        return KindsDetector(settings.kinds, settings.standing)
    kind = RoundDetector if appearance.round else OutlineDetector
    return kind(appearance, settings)


def _poses(t: float, states: TrackStates | None, drive_rate: complex) -> Poses:
    if states is None:
        none = np.empty(0)
        return Poses(
            t, np.empty(0, int), none, none, none, none, none, none, np.empty(0, bool),
            np.empty(0, int))
    return Poses(t, *_told(
        states.id, states.missed, states.measured, states.motion, states.covariance, states.sigma,
        states.theta, states.kind, states.doubt * states.astray, drive_rate))


@numba.njit(cache=True)
def _told(  # type: ignore[no-untyped-def]
        ids, missed, measured, motion, covariance, sigma, theta, kind, doubtful, drive_rate):
    """Return the fields of `Poses` after the time, of the named particles."""
    rows = np.flatnonzero(ids >= 0)
    x, y, spread = np.empty(len(rows)), np.empty(len(rows)), np.empty(len(rows))
    vx, vy, seen = np.empty(len(rows)), np.empty(len(rows)), missed[rows] == 0
    for k, n in enumerate(rows):
        x[k], y[k], variance = measured[n, 0], measured[n, 1], sigma[n] ** 2
        if not seen[k]:
            x[k], y[k] = motion[n, PLACE].real, motion[n, PLACE].imag
            variance = covariance[n, PLACE, PLACE].real
        spread[k] = math.sqrt(variance + doubtful[n])
        velocity = motion[n, VELOCITY] + drive_rate * motion[n, VELOCITY_PHASOR]
        vx[k], vy[k] = velocity.real, velocity.imag
    return ids[rows], x, y, theta[rows], vx, vy, spread, seen, kind[rows]
