"""Smooth radial profiles from the pixels of many particles at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from microbot_ros.tracking.refine.fit import (
    CONTRAST,
    OFFSET,
    SIZE,
    TABLE_STEP,
    THETA,
    X,
    Y,
    background_of,
)


class Samples(NamedTuple):
    """P pixels of particles: `r` over size [px], `angle` φ − θ [rad], `grey` over contrast.

    `weight` is the contrast [grey], `owner` the number of the particle.
    """

    r: np.ndarray
    angle: np.ndarray
    grey: np.ndarray
    weight: np.ndarray
    owner: np.ndarray


def samples(
    frames: list[np.ndarray], grids: list[np.ndarray], spacing: int,
    parameters: list[np.ndarray], reach: float,
) -> Samples:
    """Return pixels of `frames` within `reach` [px] of particles, `parameters` (N, 6) per frame.

    `grids` hold the background of each frame in cells of `spacing` px.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    grids : list of ndarray
        Background of each frame.
    spacing : int
        Size of a cell [px].
    parameters : list of ndarray
        Parameters (N, 6) of the particles in each frame.
    reach : float
        Largest distance [px].

    Returns
    -------
    Samples
        The samples.
    """
    parts: list[tuple[np.ndarray, ...]] = []
    span = int(reach)
    v, u = np.mgrid[-span:span + 1, -span:span + 1]
    for frame, grid, rows in zip(frames, grids, parameters, strict=True):
        for row in rows:
            x, y = np.rint(row[[X, Y]]).astype(int)[:, None, None] + [u, v]
            inside = (x >= 0) & (y >= 0) & (x < frame.shape[1]) & (y < frame.shape[0])
            x, y = x[inside], y[inside]
            light = background_of(grid, spacing, x, y)
            parts.append((
                np.hypot(x - row[X], y - row[Y]) / row[SIZE],
                np.arctan2(y - row[Y], x - row[X]) - np.nan_to_num(row[THETA]),
                (frame[y, x] - light - row[OFFSET]) / row[CONTRAST],
                np.full(len(x), row[CONTRAST]),
                np.full(len(x), len(parts)),
            ))
    return Samples(*(np.concatenate(part) for part in zip(*parts, strict=True)))


class RadialBasis:
    """Cubic B-splines in r up to `reach` [px], with zero slope at r = 0.

    Profiles are tabulated at `radii` (K,) [px], in steps of `TABLE_STEP`.

    Parameters
    ----------
    reach : float
        Largest radius [px].
    radii : ndarray, shape (K,)
        Radii of the table [px].
    """

    def __init__(self, reach: float, radii: np.ndarray) -> None:
        self._reach = reach
        self._radii = radii
        self._knots = np.arange(0, reach + 1, max(0.9, reach / 14))
        self._table = self._evaluate(radii)

    def at(self, r: np.ndarray) -> np.ndarray:
        """Return values (P, K) at `r` (P,), to the nearest step of the table.

        Parameters
        ----------
        r : ndarray, shape (P,)
            Radii [px].

        Returns
        -------
        ndarray, shape (P, K)
            Values.
        """
        index = np.minimum((r / TABLE_STEP + 0.5).astype(int), len(self._radii) - 1)
        return self._table[index]

    def profile(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the profile of `coefficients` (splines,) at all radii, zero beyond the reach.

        Parameters
        ----------
        coefficients : ndarray
            Coefficients of the splines.

        Returns
        -------
        ndarray
            Values at all radii.
        """
        fade = np.clip((self._reach + 1 - self._radii) / 2, 0, 1)
        return self._table @ coefficients * fade * fade * (3 - 2 * fade)

    def fit(self, pixels: Samples, harmonics: list[int]) -> np.ndarray:
        """Fit profiles (len(`harmonics`), radii) of angular harmonics to `pixels`.

        By least squares. The first is relative to its value at the reach; all are scaled such that
        its largest magnitude is 1.

        Parameters
        ----------
        pixels : Samples
            Samples of pixels.
        harmonics : list of int
            Numbers of the angular harmonics.

        Returns
        -------
        ndarray
            Profiles, one row per harmonic.
        """
        radial = self.at(pixels.r)
        design = np.hstack([radial * np.cos(m * pixels.angle)[:, None] for m in harmonics])
        design *= pixels.weight[:, None]
        normal = design.T @ design
        normal += 1e-6 * np.trace(normal) / len(normal) * np.eye(len(normal))
        solution = np.linalg.solve(normal, design.T @ (pixels.grey * pixels.weight))
        parts = np.split(solution, len(harmonics))
        far = (self._radii > 0.9 * self._reach) & (self._radii <= self._reach)
        # Even splines sum to one, so taking a constant off the coefficients shifts the profile.
        parts[0] = parts[0] - np.mean(self._table[far] @ parts[0])
        table = np.array([self.profile(part) for part in parts])
        return table / np.max(np.abs(table[0]))

    def _evaluate(self, r: np.ndarray) -> np.ndarray:
        from scipy.interpolate import BSpline

        bump = BSpline.basis_element(self._knots[1] * np.arange(-2, 3), extrapolate=False)
        mirrored = np.where(self._knots > 0, np.nan_to_num(bump(r[:, None] + self._knots)), 0.0)
        return np.nan_to_num(bump(r[:, None] - self._knots)) + mirrored
