"""The particles being followed: what is known of each, and the filter that keeps it so."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.link.motion import Motion

PLACE, VELOCITY, VELOCITY_PHASOR = range(3)
"""Columns of `TrackStates.motion`, and rows and columns of its covariance."""

UNNAMED = -1
"""Identity of a particle that has not been seen often enough to have one."""

LEAST_SIGMA = 0.05
"""Pixels: no prediction is better than this, whatever the formulas say."""

_SURPRISE = 9.0
"""Squared innovation, in its variance, from which a particle is taken to have changed course."""

_PHASOR_LASTS = 1000.0
"""Frames over which a particle's velocity phasor is expected to change."""


@dataclass
class TrackStates:
    """The particles being followed, arrays of equal length N; px, s, rad.

    `id` identities; `motion` (N, 3) complex, x + iy: place [px], velocity of its own [px/s],
    velocity phasor [px per unit of the drive]: speed times e^{iφ}, the same at every direction of
    the drive. `covariance` (N, 3, 3) Hermitian, of these, per coordinate. `measured` (N, 2) the
    last measurement, with its `sigma`, `theta`, `contrast` and `radius`; `step` (N, 2) the
    displacement to it that neither drive nor jump explains, NaN after a gap; `hits` the frames
    seen, `missed` the frames since; `host` the identity of the particle that it has merged with,
    −1 where it is on its own; `outline` [px] the radius of the last outline, of both where two are
    in one; `early` (N, K, 2) the first K measurements; `kind` the number of its
    kind when it was first seen. `doubt` the probability that it is another than its identity says,
    0 where that is sure; `unsure` [s] for how long it has been so; `astray` [px²] the variance per
    coordinate of where it would be then, about where it is seen. Of what is longer than wide:
    `tail` the last direction of its tail, NaN before it shows, and `along` [px] how far it went
    the other way lately.
    """

    id: np.ndarray
    motion: np.ndarray
    covariance: np.ndarray
    measured: np.ndarray
    step: np.ndarray
    sigma: np.ndarray
    theta: np.ndarray
    contrast: np.ndarray
    radius: np.ndarray
    hits: np.ndarray
    missed: np.ndarray
    host: np.ndarray
    outline: np.ndarray
    early: np.ndarray
    kind: np.ndarray
    doubt: np.ndarray
    unsure: np.ndarray
    astray: np.ndarray
    tail: np.ndarray
    along: np.ndarray

    def __len__(self) -> int:
        return len(self.id)

    @property
    def xy(self) -> np.ndarray:
        """Where the particles are taken to be, (N, 2) [px]."""
        return planar(self.motion[:, PLACE])

    def velocity(self, drive_rate: complex) -> np.ndarray:
        """Velocity (N, 2) [px/s] under a drive of `drive_rate` per second."""
        return planar(self.motion[:, VELOCITY] + drive_rate * self.motion[:, VELOCITY_PHASOR])

    def take(self, rows: np.ndarray) -> TrackStates:
        """The particles of some `rows`, numbers or a mask."""
        return TrackStates(*(getattr(self, part.name)[rows] for part in fields(self)))

    def join(self, other: TrackStates) -> TrackStates:
        """These and others."""
        return TrackStates(*(
            np.concatenate([getattr(self, part.name), getattr(other, part.name)])
            for part in fields(self)
        ))

    def forget_velocity_phasor(self, variance: float) -> None:
        """Start learning the velocity phasor anew, from nothing known to `variance`."""
        self.motion[:, VELOCITY_PHASOR] = 0.0
        self.covariance[:, VELOCITY_PHASOR] = self.covariance[:, :, VELOCITY_PHASOR] = 0.0
        self.covariance[:, VELOCITY_PHASOR, VELOCITY_PHASOR] = variance

    def predict(self, dt: float, interval: float, drive: complex, motion: Motion,
                phasor_variance: float) -> None:
        """Move all on by `dt` [s], where frames usually come every `interval`, under `drive`.

        `phasor_variance` is that of a velocity phasor of which nothing is known.
        """
        frames = dt / interval
        keep = motion.keep(frames)
        _predict(self.motion, self.covariance, dt, drive, keep, np.array([
            motion.random_step * frames,
            motion.velocity_step / interval**2 * (1 - keep**2),
            phasor_variance * frames / _PHASOR_LASTS]))

    def correct(self, rows: np.ndarray, found: np.ndarray, noise: np.ndarray) -> None:
        """Kalman update of some `rows` (K,) by the places `found` (K, 2) of variance `noise` (K,).

        In Joseph's form: the short one lets rounding errors of a covariance grow.
        """
        _correct(self.motion, self.covariance, rows, found, noise)

    def keep_within(self, rows: np.ndarray, middle: np.ndarray) -> None:
        """Move those `rows` (K,) that have fallen behind back into their outlines, about the
        `middle` (K, 2) [px] of each.
        """
        behind = self.motion[rows, PLACE] - phasor(middle)
        away = np.maximum(np.abs(behind), 1e-9)
        self.motion[rows, PLACE] -= behind * np.maximum(1 - self.outline[rows] / away, 0)


@numba.njit(cache=True)
def _predict(motion, covariance, dt, drive, keep, added):  # type: ignore[no-untyped-def]
    """Both after a step, in place; `added` (3,) is what chance adds to the variances."""
    for n in range(len(motion)):
        motion[n, 0] += dt * motion[n, 1] + drive * motion[n, 2]
        motion[n, 1] *= keep
        for k in range(3):
            covariance[n, 0, k] += dt * covariance[n, 1, k] + drive * covariance[n, 2, k]
            covariance[n, 1, k] *= keep
        for k in range(3):
            covariance[n, k, 0] += (
                dt * covariance[n, k, 1] + drive.conjugate() * covariance[n, k, 2])
            covariance[n, k, 1] *= keep
            covariance[n, k, k] += added[k]


@numba.njit(cache=True)
def _correct(motion, covariance, rows, found, noise):  # type: ignore[no-untyped-def]
    """`TrackStates.correct`, in place."""
    left, turned = np.empty((3, 3), np.complex128), np.empty((3, 3), np.complex128)
    for j, n in enumerate(rows):
        innovation = complex(found[j, 0], found[j, 1]) - motion[n, PLACE]
        square = innovation.real**2 + innovation.imag**2
        surprise = square / 2 / (covariance[n, PLACE, PLACE].real + noise[j])
        # A particle that starts, stops or turns has outrun its covariance; let that catch up.
        before = covariance[n] * max(surprise / _SURPRISE, 1.0)
        gain = before[:, PLACE] / (before[PLACE, PLACE].real + noise[j])
        left[:] = np.eye(3)
        for k in range(3):
            motion[n, k] += gain[k] * innovation
            left[k, PLACE] -= gain[k]
        for k in range(3):
            for m in range(3):
                turned[k, m] = (left[k, 0] * before[0, m] + left[k, 1] * before[1, m]
                                + left[k, 2] * before[2, m])
        for k in range(3):
            for m in range(3):
                covariance[n, k, m] = (
                    turned[k, 0] * left[m, 0].conjugate() + turned[k, 1] * left[m, 1].conjugate()
                    + turned[k, 2] * left[m, 2].conjugate()
                    + noise[j] * gain[k] * gain[m].conjugate())


def initiate_tracks(
    xy: np.ndarray, sigma: np.ndarray, theta: np.ndarray, contrast: np.ndarray,
    radius: np.ndarray, kind: np.ndarray, velocity_variance: float, phasor_variance: float,
    early_frames: int,
) -> TrackStates:
    """States of particles seen for the first time.

    `xy` (N, 2), `sigma`, `theta`, `contrast`, `radius` (N,) as measured,
    and `kind`; `velocity_variance`
    [px²/s²] and `phasor_variance` of what is not known yet; `early_frames` measurements will be
    kept.
    """
    count = len(xy)
    early = np.full((count, early_frames, 2), np.nan)
    early[:, 0] = xy
    motion = np.zeros((count, 3), complex)
    motion[:, PLACE] = phasor(xy)
    covariance = np.zeros((count, 3, 3), complex)
    covariance[:, PLACE, PLACE] = sigma**2 + LEAST_SIGMA**2
    covariance[:, VELOCITY, VELOCITY] = velocity_variance
    covariance[:, VELOCITY_PHASOR, VELOCITY_PHASOR] = phasor_variance
    return TrackStates(
        id=np.full(count, UNNAMED), motion=motion, covariance=covariance, measured=xy.copy(),
        step=np.full((count, 2), np.nan), sigma=sigma.copy(), theta=theta.copy(),
        contrast=contrast.copy(), radius=radius.copy(), hits=np.ones(count, int),
        missed=np.zeros(count, int), host=np.full(count, -1), outline=radius.copy(), early=early,
        kind=kind.copy(), doubt=np.zeros(count), unsure=np.zeros(count), astray=np.zeros(count),
        tail=np.full(count, np.nan), along=np.zeros(count))


def phasor(xy: np.ndarray) -> np.ndarray:
    """Vectors `xy` (..., 2) as complex x + iy (...)."""
    return xy[..., 0] + 1j * xy[..., 1]


def planar(z: np.ndarray) -> np.ndarray:
    """Complex `z` = x + iy (...) as vectors (..., 2)."""
    parts: np.ndarray = np.ascontiguousarray(z).view(float).reshape(*z.shape, 2)
    return parts
