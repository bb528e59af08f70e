"""Predictive check: measured tracks against the band that the final model predicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.discovery.report.residual import Residual
from microbot_ros.discovery.result import Discovery

SHORTEST, MOST = 10.0, 12
"""Shortest stretch [s] of a prediction, after which it restarts from the measured place, and the
maximum number of stretches (`MOST`).

Choice: long enough for an effect to show beside diffusion, short enough for a figure."""

EDGE = 1.645
"""5 % and 95 % quantiles of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Prediction:
    """Measured less predicted positions of a session, in stretches of open-loop prediction.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Times [s].
    names : tuple of str
        Names of the N particles.
    measured, without : ndarray, shape (N, T, 2)
        Deviations [m] from the final and the first-order model; NaN in gaps.
    band : ndarray, shape (N, T)
        Half-width [m] within which the final model expects 90 % of coordinates; NaN if v is
        unknown.
    elapsed : ndarray, shape (N, T)
        Time [s] since the start of the stretch; NaN until the particle is seen.
    """

    times: np.ndarray
    names: tuple[str, ...]
    measured: np.ndarray
    without: np.ndarray
    band: np.ndarray
    elapsed: np.ndarray

    @property
    def inside(self) -> float:
        """Fraction of measured coordinates within the band, without starts; NaN without a band."""
        known = np.isfinite(self.measured) & (
            (self.elapsed > 0) & np.isfinite(self.band))[..., None]
        within = np.abs(self.measured) <= self.band[..., None]
        return float(within[known].mean()) if known.any() else float('nan')


def predict(found: Discovery, left: Residual) -> Prediction:
    """Predict the session that the particles of a result belong to.

    The width of the band is due to diffusion, to two position readings, and to the errors of v and
    φ beside the effects, which grow in proportion to the path.

    Parameters
    ----------
    found : Discovery
        Result of the search.
    left : Residual
        Residuals of that session.

    Returns
    -------
    Prediction
        Deviations and band.
    """
    starts = _starts(left)
    measured, without, swum = (_since(x, starts) for x in (left.found, left.plain, left.path))
    elapsed = np.take(left.times, starts).T
    elapsed = np.where(starts.T >= 0, left.times - elapsed, np.nan)
    speed_std = np.where(np.isfinite(left.speed_std), left.speed_std, np.nan)
    variance = (2 * found.diffusion.value * elapsed + 2 * found.localisation.value**2
                + speed_std[:, None] ** 2 * (swum**2).sum(axis=-1))
    return Prediction(left.times, left.names, measured, without, EDGE * np.sqrt(variance),
                      elapsed)


def _starts(left: Residual) -> np.ndarray:
    """Return the frame (T, N) from which each place is predicted; −1 until a particle is seen.

    A stretch also ends where a particle jumps, since no model predicts that.
    """
    span = float(np.ptp(left.times))
    block = ((left.times - left.times[0]) / max(SHORTEST, span / MOST)).astype(int)
    stretch = block[:, None] + np.cumsum(left.jumps, axis=0)
    seen = np.isfinite(left.found[..., 0])
    starts = np.full(seen.shape, -1)
    for n in range(seen.shape[1]):
        for part in np.unique(stretch[:, n]):
            rows = np.flatnonzero(stretch[:, n] == part)
            first = rows[seen[rows, n]][:1]
            if first.size:
                starts[rows[rows >= first[0]], n] = first[0]
    return starts


def _since(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return values (T, N, 2) less those at the start of each stretch, as (N, T, 2)."""
    base = np.take_along_axis(values, np.maximum(starts, 0)[..., None], axis=0)
    return np.moveaxis(np.where(starts[..., None] >= 0, values - base, np.nan), 0, 1)
