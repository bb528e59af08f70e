"""States of the followed particles, and their filter."""

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
"""Choice: least uncertainty of a prediction [px]."""

_SURPRISE = 9.0
"""Choice: squared innovation over its variance from which a particle has changed course."""

_PHASOR_LASTS = 1000.0
"""Choice: frames over which a particle's velocity phasor is expected to change."""


@dataclass
class TrackStates:
    """States of N followed particles, arrays of equal length.

    Attributes
    ----------
    id : (N,) int array
    motion : (N, 3) complex array
        x + iy of position [px], own velocity [px/s], and velocity phasor [px per unit of drive]:
        speed times e^{iφ}, equal for all directions of the drive.
    covariance : (N, 3, 3) complex array
        Hermitian covariance of `motion`, per coordinate.
    measured, step : (N, 2) array [px]
        Last measurement, and the displacement to it that neither drive nor jump explains, NaN
        after a gap.
    sigma, theta, contrast, radius : (N,) array [px], [rad], [grey], [px]
        Of the last measurement.
    hits, missed : (N,) int array
        Frames seen, and frames since.
    host : (N,) int array
        Identity of the particle it has merged with, −1 if alone.
    outline : (N,) array [px]
        Radius of the last outline, of both if shared.
    early : (N, K, 2) array [px]
        First K measurements.
    kind : (N,) int array
        Kind when first seen.
    doubt, unsure, astray : (N,) array
        Probability of being another particle, how long that lasts [frames], and the variance per
        coordinate of its place in that case [px²].
    tail, along : (N,) array [rad], [px]
        Of elongated bodies: last direction of the tail, NaN before it shows, and recent motion
        away from it.
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
        """Estimated positions (N, 2) [px]."""
        return planar(self.motion[:, PLACE])

    def velocity(self, drive_rate: complex) -> np.ndarray:
        """Return velocities (N, 2) [px/s] under a drive of `drive_rate` per second.

        Parameters
        ----------
        drive_rate : complex
            Drive per second, complex.

        Returns
        -------
        ndarray, shape (N, 2)
            Velocities [px/s].
        """
        return planar(self.motion[:, VELOCITY] + drive_rate * self.motion[:, VELOCITY_PHASOR])

    def take(self, rows: np.ndarray) -> TrackStates:
        """Return the particles of `rows`, numbers or a mask.

        Parameters
        ----------
        rows : ndarray
            Row numbers (K,), or a mask (N,).

        Returns
        -------
        TrackStates
            States of these.
        """
        return TrackStates(*(getattr(self, part.name)[rows] for part in fields(self)))

    def join(self, other: TrackStates) -> TrackStates:
        """Return these particles and those of `other`.

        Parameters
        ----------
        other : TrackStates
            The other particles.

        Returns
        -------
        TrackStates
            States of all.
        """
        return TrackStates(*(
            np.concatenate([getattr(self, part.name), getattr(other, part.name)])
            for part in fields(self)
        ))

    def forget_velocity_phasor(self, variance: float) -> None:
        """Reset the velocity phasors to zero with this `variance`.

        Parameters
        ----------
        variance : float
            Variance of an unknown velocity phasor.
        """
        self.motion[:, VELOCITY_PHASOR] = 0.0
        self.covariance[:, VELOCITY_PHASOR] = self.covariance[:, :, VELOCITY_PHASOR] = 0.0
        self.covariance[:, VELOCITY_PHASOR, VELOCITY_PHASOR] = variance

    def predict(self, dt: float, interval: float, drive: complex, motion: Motion,
                phasor_variance: float) -> None:
        """Predict all particles `dt` [s] ahead under `drive`; `interval` [s] is the usual one.

        `motion` gives the random steps; `phasor_variance` is that of an unknown velocity phasor.

        Parameters
        ----------
        dt : float
            Time ahead [s].
        interval : float
            Usual time between frames [s].
        drive : complex
            Drive, complex, integrated over that time.
        motion : Motion
            Motion of the particles.
        phasor_variance : float
            Variance of an unknown velocity phasor.
        """
        frames = dt / interval
        keep = motion.keep(frames)
        _predict(self.motion, self.covariance, dt, drive, keep, np.array([
            motion.random_step * frames,
            motion.velocity_step / interval**2 * (1 - keep**2),
            phasor_variance * frames / _PHASOR_LASTS]))

    def correct(self, rows: np.ndarray, found: np.ndarray, noise: np.ndarray) -> None:
        """Apply a Kalman update to `rows` (K,) by places `found` (K, 2) of variance `noise` (K,).

        Joseph's form, since the short form accumulates rounding errors of the covariance.

        Parameters
        ----------
        rows : ndarray, shape (K,)
            Rows of the particles.
        found : ndarray, shape (K, 2)
            Measured places [px].
        noise : ndarray, shape (K,)
            Variance of each [px²].
        """
        _correct(self.motion, self.covariance, rows, found, noise)

    def keep_within(self, rows: np.ndarray, middle: np.ndarray) -> None:
        """Move `rows` (K,) back into their outlines about `middle` (K, 2) [px].

        Parameters
        ----------
        rows : ndarray, shape (K,)
            Rows of the particles.
        middle : ndarray, shape (K, 2)
            Middles of the outlines [px].
        """
        behind = self.motion[rows, PLACE] - phasor(middle)
        away = np.maximum(np.abs(behind), 1e-9)
        self.motion[rows, PLACE] -= behind * np.maximum(1 - self.outline[rows] / away, 0)


@numba.njit(cache=True)
def _predict(motion, covariance, dt, drive, keep, added):  # type: ignore[no-untyped-def]
    """Predict both in place; `added` (3,) are the random contributions to the variances."""
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
    """Apply `TrackStates.correct` in place."""
    left, turned = np.empty((3, 3), np.complex128), np.empty((3, 3), np.complex128)
    for j, n in enumerate(rows):
        innovation = complex(found[j, 0], found[j, 1]) - motion[n, PLACE]
        square = innovation.real**2 + innovation.imag**2
        surprise = square / 2 / (covariance[n, PLACE, PLACE].real + noise[j])
        # A particle that starts, stops or turns has left its covariance, which is inflated.
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
    """Return states of particles seen for the first time.

    Parameters
    ----------
    xy : (N, 2) array [px]
        Detected positions.
    sigma, theta, contrast, radius : (N,) array
        Standard deviation of the position [px], heading [rad], contrast and radius [px].
    kind : (N,) int array
        Index of the kind of each particle.
    velocity_variance : float [px²/s²]
        Initial variance of the velocity.
    phasor_variance : float
        Initial variance of the velocity phasor.
    early_frames : int
        Number of first measurements that are kept.

    Returns
    -------
    TrackStates
        The states.
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
    """Convert vectors `xy` (..., 2) to complex x + iy (...).

    Parameters
    ----------
    xy : ndarray, shape (..., 2)
        Vectors.

    Returns
    -------
    ndarray, shape (...)
        Complex numbers.
    """
    return xy[..., 0] + 1j * xy[..., 1]


def planar(z: np.ndarray) -> np.ndarray:
    """Convert complex `z` = x + iy (...) to vectors (..., 2).

    Parameters
    ----------
    z : ndarray
        Complex numbers, of any shape.

    Returns
    -------
    ndarray, shape (..., 2)
        Vectors.
    """
    parts: np.ndarray = np.ascontiguousarray(z).view(float).reshape(*z.shape, 2)
    return parts
