"""Coils that others describe: magpylib's sources, and what packages bring by entry point."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.errors import InputError
from microbot_ros.common.plugins import installed
from microbot_ros.magnetics.sources import Source, as_points

GROUP = 'microbot_ros.coils'
"""Entry points of coils: each a `Source`, or a source or collection of magpylib's under 1 A."""


class MagpylibSource:
    """A source or collection of magpylib's, as it stands under 1 A in the coil.

    `source`: what `magpylib.getB` takes. The gradient is its central difference of fourth order
    over `step` [m], good to about (step/distance)⁴. InputError where magpylib is not installed,
    and for a step that is not positive.
    """

    def __init__(self, source: Any, step: float = 1e-4) -> None:
        try:
            import magpylib
        except ImportError:
            raise InputError('magpylib', 'expected it to be installed for a coil that is one of '
                             'its sources; pip install magpylib') from None
        if not 0 < step < math.inf:
            raise InputError('step', f'expected a positive, finite length, got {step} m')
        self._field, self._source, self._step = magpylib.getB, source, step

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Field [T/A] at points (M, 3) [m]: (M, 3)."""
        points = as_points(points)
        return np.reshape(self._field(self._source, points, sumup=True), points.shape)

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Gradient ∂Bᵢ/∂xⱼ [T/m/A] at points (M, 3) [m]: (M, 3, 3)."""
        points = as_points(points)
        shifts = self._step * np.multiply.outer((-2, -1, 1, 2), np.eye(3))
        near = self.field_per_ampere((points + shifts[:, :, None]).reshape(-1, 3))
        weights = np.array([1, -8, 8, -1]) / (12 * self._step)
        return np.einsum('s,sjmi->mij', weights, near.reshape(4, 3, len(points), 3))

    def margin(self, point: np.ndarray) -> float:
        """Infinite at every `point`: magpylib does not say where its wires are."""
        return math.inf


def installed_source(name: str) -> Source:
    """The coil that a package brings under this name in the group `microbot_ros.coils`.

    InputError where there is none, or where it does not load.
    """
    found = installed(GROUP, 'source', name)
    return found if hasattr(found, 'field_per_ampere') else MagpylibSource(found)
