"""How the field of the rig's coils changes from place to place, tabulated by Biot and Savart.

So are the moments that this pulls at a given rate at the centre.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from microbot_ros.magnetics import Allocator, CoilSet

SPACING = 0.25e-3
"""Between the places of the table, either way [m]."""

_REACH = 20
"""Places from the centre to an edge of the table."""

_NEAR = 1e-6
"""So near the centre the gradient of a pair is proportional to the distance [m]."""


@cache
def coil_gradients() -> np.ndarray:
    """Gradients over the field at the centre (2, K, K, 3) [1/m], of the default coils.

    First of the two coils on the x axis, driven as for a field along x; then of the one at +x
    alone. At the place x (second axis), y (third), K of them about the centre, `SPACING` apart:
    ∂Bx/∂x, ∂Bx/∂y = ∂By/∂x and ∂By/∂y.
    """
    line = SPACING * np.arange(-_REACH, _REACH + 1)
    places = np.stack(np.meshgrid(line, line, indexing='ij'), axis=-1)
    return _along_x(places.reshape(-1, 2)).reshape(2, *places.shape[:2], 3)


@cache
def pull_of_pair() -> float:
    """B''/2B at the centre, on the axis of a pair of coils [1/m²].

    A moment over drag, in m²/(T s), times this is the rate of a `gradient_force`.
    """
    return float(_along_x(np.array([[_NEAR, 0.0]]))[0, 0, 0] / (2 * _NEAR))


@cache
def pull_of_coil() -> float:
    """B'/B at the centre, towards the only coil that is driven [1/m]; the same for `coil_pull`."""
    return float(_along_x(np.zeros((1, 2)))[1, 0, 0])


def _along_x(places: np.ndarray) -> np.ndarray:
    """The rows of `coil_gradients` at `places` (M, 2) [m]: (2, M, 3)."""
    coils = CoilSet()
    pair = Allocator(coils).allocate((1e-3, 0.0)).currents
    alone = np.where(np.array(coils.names) == 'coil_plus_x', 1.0, 0.0)
    driven = []
    for currents in (pair, alone):
        gradient = coils.gradient(currents, places) / (coils.actuation_matrix() @ currents)[0]
        driven.append(np.stack((gradient[:, 0, 0], gradient[:, 0, 1], gradient[:, 1, 1]), axis=1))
    return np.array(driven)
