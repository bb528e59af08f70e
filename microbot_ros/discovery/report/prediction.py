"""The predictive check: measured tracks against the band in which the model found expects them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.discovery.report.residual import Residual
from microbot_ros.discovery.result import Discovery

SHORTEST, MOST = 10.0, 12
"""Predictions start anew from the measured place after this long [s], but not more often."""

EDGE = 1.645
"""The 5 % and 95 % points of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Prediction:
    """Measured less predicted positions of a session, predicted without looking for a while.

    `times` (T,) [s]; `names` of the N particles; `measured` and `without` (N, T, 2) [m] are
    against the model found and the first-order model, NaN for gaps; the model found expects nine
    in ten coordinates within ± `band` (N, T) [m], NaN where v is not known; `elapsed` (N, T) [s]
    since the place that a prediction started from, NaN until the particle is seen.
    """

    times: np.ndarray
    names: tuple[str, ...]
    measured: np.ndarray
    without: np.ndarray
    band: np.ndarray
    elapsed: np.ndarray

    @property
    def inside(self) -> float:
        """The fraction of the measured coordinates within the band, starts left out.

        NaN where no band is known.
        """
        known = np.isfinite(self.measured) & (
            (self.elapsed > 0) & np.isfinite(self.band))[..., None]
        within = np.abs(self.measured) <= self.band[..., None]
        return float(within[known].mean()) if known.any() else float('nan')


def predict(found: Discovery, left: Residual) -> Prediction:
    """The check of what was `found` on the session that its particles belong to.

    `left` is the residual of that session. The band is wide by diffusion, by two readings, and by
    how well v and φ are known beside the effects: their error carries a particle off in
    proportion to the way it has swum.
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
    """The frame (T, N) from which each place is predicted; −1 until a particle is seen.

    A stretch ends after a while, and where a particle jumps: no model follows that.
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
    """Values (T, N, 2) less those at the start of each stretch: (N, T, 2)."""
    base = np.take_along_axis(values, np.maximum(starts, 0)[..., None], axis=0)
    return np.moveaxis(np.where(starts[..., None] >= 0, values - base, np.nan), 0, 1)
