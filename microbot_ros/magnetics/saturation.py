"""The core of a coil saturates: what a current is worth in field, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.errors import InputError


class Saturation:
    """Effective over true current, from `points` of both [A], each rising from the origin.

    The effective current is the one that would make the same field if the core stayed linear. The
    curve is monotone and smooth (Fritsch and Carlson's cubic pieces), and odd. It is fitted to the
    true current over the effective one, the way in which every field is looked up. InputError for
    points that do not rise or are not finite.
    """

    def __init__(self, points: Sequence[tuple[float, float]]) -> None:
        from scipy.interpolate import PchipInterpolator
        pairs = np.vstack([(0.0, 0.0), np.asarray(points, dtype=float).reshape(-1, 2)])
        rise = np.diff(pairs, axis=0)
        if not (len(rise) and np.isfinite(pairs).all() and (rise > 0).all()):
            raise InputError('saturation', 'expected pairs [A, effective A] that rise from 0')
        true, effective = pairs.T
        self._last = pairs[-1].tolist()
        self._driven = PchipInterpolator(effective, true, extrapolate=False)

    def driven(self, effective: ArrayLike) -> np.ndarray:
        """The true currents [A] worth `effective` ones [A]; NaN beyond the curve."""
        return np.sign(effective) * self._driven(np.abs(effective))

    def effective(self, driven: ArrayLike) -> np.ndarray:
        """What true currents `driven` [A] are worth [A]; NaN beyond the curve."""
        driven = np.asarray(driven, dtype=float)
        found = [self._inverse(current) for current in np.abs(driven).ravel().tolist()]
        return np.sign(driven) * np.reshape(found, driven.shape)

    def _inverse(self, current: float) -> float:
        if not current < self._last[0]:  # at the end itself rounding may leave no root
            return self._last[1] if current == self._last[0] else math.nan
        return float(self._driven.solve(current, extrapolate=False)[0])
