"""Table of the field gradients of the rig's coils, by Biot and Savart, and moments for rates."""

from __future__ import annotations

from functools import cache

import numpy as np

from microbot_ros.magnetics import Allocator, CoilSet

SPACING = 0.25e-3
"""Choice: spacing of the table [m], 1/120 of the distance to the coils."""

_REACH = 20
"""Choice: points from the centre to an edge of the table, ±5 mm."""

_NEAR = 1e-6
"""Choice: distance [m] at which the gradient of a pair is still proportional to it."""


@cache
def coil_gradients() -> np.ndarray:
    """Return gradients over the field at the centre, (2, K, K, 3) [1/m], of the default coils.

    The first axis is the pair of coils on the x axis, driven for a field along x, and the coil at
    +x alone; then position x and y, K each about the centre, `SPACING` apart; last ∂Bx/∂x, ∂Bx/∂y
    = ∂By/∂x and ∂By/∂y.

    Returns
    -------
    ndarray, shape (2, K, K, 3)
        Gradients over the field [1/m].
    """
    line = SPACING * np.arange(-_REACH, _REACH + 1)
    places = np.stack(np.meshgrid(line, line, indexing='ij'), axis=-1)
    return _along_x(places.reshape(-1, 2)).reshape(2, *places.shape[:2], 3)


@cache
def pull_of_pair() -> float:
    """Return B''/2B [1/m²] at the centre, on the axis of a pair of coils.

    Times a moment over drag [m²/(T s)] it is the rate of a `gradient_force`.

    Returns
    -------
    float
        B''/2B [1/m²].
    """
    return float(_along_x(np.array([[_NEAR, 0.0]]))[0, 0, 0] / (2 * _NEAR))


@cache
def pull_of_coil() -> float:
    """Return B'/B [1/m] at the centre, towards the only driven coil, for `coil_pull`.

    Returns
    -------
    float
        B'/B [1/m].
    """
    return float(_along_x(np.zeros((1, 2)))[1, 0, 0])


def _along_x(places: np.ndarray) -> np.ndarray:
    """Return the rows of `coil_gradients` at `places` (M, 2) [m], (2, M, 3)."""
    coils = CoilSet()
    pair = Allocator(coils).allocate((1e-3, 0.0)).currents
    alone = np.where(np.array(coils.names) == 'coil_plus_x', 1.0, 0.0)
    driven = []
    for currents in (pair, alone):
        gradient = coils.gradient(currents, places) / (coils.actuation_matrix() @ currents)[0]
        driven.append(np.stack((gradient[:, 0, 0], gradient[:, 0, 1], gradient[:, 1, 1]), axis=1))
    return np.array(driven)
