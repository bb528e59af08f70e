"""Vectors in the plane: as pairs along the last axis (..., 2) and as complex numbers x + iy."""

from __future__ import annotations

import numpy as np


def unit(angle: np.ndarray | float) -> np.ndarray:
    """Unit vectors (..., 2) at an `angle` (...) [rad]."""
    return np.stack((np.cos(angle), np.sin(angle)), axis=-1)


def as_complex(vectors: np.ndarray) -> np.ndarray:
    """Real `vectors` (..., 2) as complex numbers (...), the inverse of `as_vectors`."""
    return np.ascontiguousarray(vectors).view(complex)[..., 0]


def as_vectors(z: np.ndarray) -> np.ndarray:
    """Complex `z` (...) as real vectors (..., 2), the inverse of `as_complex`."""
    return np.ascontiguousarray(z).view(float).reshape(*z.shape, 2)
