"""Traits that distinguish particles, besides their positions."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba

LOOKS_SPREAD = 0.25
"""Choice: std of ln(contrast) and ln(radius) of one particle from frame to frame."""

_OTHER_KIND = 0.9
"""Choice: weight of another kind, e⁻⁶ in likelihood, so that a mistaken kind is tolerated."""


@numba.njit(cache=True)
def looks(contrast, radius, kind):  # type: ignore[no-untyped-def]
    """Return traits (N, 3): logarithms of `contrast` and `radius`, and weighted `kind`.

    Parameters
    ----------
    contrast : ndarray, shape (N,)
        Contrasts [grey].
    radius : ndarray, shape (N,)
        Radii [px].
    kind : ndarray, shape (N,)
        Numbers of the kinds.
    """
    traits = np.empty((len(contrast), 3))
    traits[:, 0], traits[:, 1] = np.log(contrast), np.log(radius)
    traits[:, 2] = _OTHER_KIND * kind
    return traits
