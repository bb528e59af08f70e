"""Coils described outside this package: magpylib sources and entry points of other packages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.errors import InputError
from microbot_ros.common.extras import installed
from microbot_ros.magnetics.sources import Source, as_points

GROUP = 'microbot_ros.coils'
"""Entry-point group of coils: each entry is a `Source`, or a magpylib object that carries 1 A."""


class MagpylibSource:
    """Field per ampere of a magpylib source or collection that carries 1 A.

    The gradient is a central difference of fourth order; its relative error is about
    (step/distance)⁴.

    Parameters
    ----------
    source : magpylib source or collection
        Whatever `magpylib.getB` accepts.
    step : float
        Step of the difference [m].

    Raises
    ------
    InputError
        If magpylib is not installed or `step` is not positive and finite.
    """

    def __init__(self, source: Any, step: float = 1e-4) -> None:
        try:
            import magpylib
        except ImportError:
            raise InputError('magpylib', 'expected it to be installed for a coil that is one of '
                             'its sources; pip install magpylib') from None
        if not 0 < step < math.inf:
            raise InputError('step', f'expected a positive, finite length; received {step} m')
        self._field, self._source, self._step = magpylib.getB, source, step

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return the field [T/A] at `points` (M, 3) [m], shape (M, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3)
            Field [T/A].
        """
        points = as_points(points)
        return np.reshape(self._field(self._source, points, sumup=True), points.shape)

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m/A] at `points` (M, 3) [m], shape (M, 3, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3, 3)
            Gradient [T/m/A].
        """
        points = as_points(points)
        shifts = self._step * np.multiply.outer((-2, -1, 1, 2), np.eye(3))
        near = self.field_per_ampere((points + shifts[:, :, None]).reshape(-1, 3))
        weights = np.array([1, -8, 8, -1]) / (12 * self._step)
        return np.einsum('s,sjmi->mij', weights, near.reshape(4, 3, len(points), 3))

    def margin(self, point: np.ndarray) -> float:
        """Return infinity for every `point`: magpylib does not report where its wires are.

        Parameters
        ----------
        point : ndarray, shape (3,)
            Point [m].

        Returns
        -------
        float
            Infinity.
        """
        return math.inf


def installed_source(name: str) -> Source:
    """Load the coil with this name from the entry-point group `microbot_ros.coils`.

    Raises InputError if no package provides it or it cannot be loaded.

    Parameters
    ----------
    name : str
        Name of the coil.

    Returns
    -------
    Source
        The coil.
    """
    found = installed(GROUP, 'source', name)
    return found if hasattr(found, 'field_per_ampere') else MagpylibSource(found)
