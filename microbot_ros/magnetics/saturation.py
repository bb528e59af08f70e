"""Saturation of a coil's core: true current to effective current and back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.errors import InputError

_MEASURED = 0.02
"""Fraction of its last point by which a current may exceed a curve.

Choice: readings of the full current scatter by a percent; at half, some have no field, at twice, a
wrong curve goes unnoticed.
"""


class Saturation:
    """Curve of effective over true current of a coil with a saturating core.

    The effective current is the one that would make the same field if the core stayed linear. The
    curve is monotone, smooth (piecewise cubic, Fritsch and Carlson) and odd. True current is
    fitted over effective current, because every wanted field needs that direction.

    Parameters
    ----------
    points : sequence of pairs
        True and effective current [A], both increasing from the origin.

    Raises
    ------
    InputError
        For points that do not increase or are not finite.
    """

    def __init__(self, points: Sequence[tuple[float, float]]) -> None:
        from scipy.interpolate import PchipInterpolator
        pairs = np.vstack([(0.0, 0.0), np.asarray(points, dtype=float).reshape(-1, 2)])
        rise = np.diff(pairs, axis=0)
        if not (len(rise) and np.isfinite(pairs).all() and (rise > 0).all()):
            raise InputError('saturation', 'expected pairs [A, effective A] ascending from 0')
        true, effective = pairs.T
        self._last, self._slope = pairs[-1].tolist(), float(rise[-1, 1] / rise[-1, 0])
        self._driven = PchipInterpolator(effective, true, extrapolate=False)

    def driven(self, effective: ArrayLike) -> np.ndarray:
        """Convert `effective` currents [A] to true ones; NaN beyond the curve.

        Parameters
        ----------
        effective : ArrayLike
            Effective currents, of any shape [A].

        Returns
        -------
        ndarray
            Currents of the windings [A], of the same shape.
        """
        return np.sign(effective) * self._driven(np.abs(effective))

    def effective(self, driven: ArrayLike) -> np.ndarray:
        """Convert true currents `driven` [A] to effective ones; NaN beyond the curve.

        Just beyond it, as a reading of the largest current may be, it goes on along its last two
        points.

        Parameters
        ----------
        driven : ArrayLike
            Currents of the windings [A], of any shape.

        Returns
        -------
        ndarray
            Effective currents [A], of the same shape.
        """
        driven = np.asarray(driven, dtype=float)
        found = [self._inverse(current) for current in np.abs(driven).ravel().tolist()]
        return np.sign(driven) * np.reshape(found, driven.shape)

    def _inverse(self, current: float) -> float:
        if not current < self._last[0]:  # at the end itself rounding may leave no root
            if not current <= (1 + _MEASURED) * self._last[0]:
                return math.nan
            return float(self._last[1] + (current - self._last[0]) * self._slope)
        return float(self._driven.solve(current, extrapolate=False)[0])
