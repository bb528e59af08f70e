"""Vectors in the plane, as pairs along the last axis and as complex numbers x + iy."""

from __future__ import annotations

import numpy as np


def unit(angle: np.ndarray | float) -> np.ndarray:
    """Return unit vectors.

    Parameters
    ----------
    angle : ndarray or float
        Angles [rad], of any shape (...).

    Returns
    -------
    ndarray, shape (..., 2)
        Unit vectors.
    """
    return np.stack((np.cos(angle), np.sin(angle)), axis=-1)


def as_complex(vectors: np.ndarray) -> np.ndarray:
    """Return vectors as complex numbers, the inverse of `as_vectors`.

    Parameters
    ----------
    vectors : ndarray, shape (..., 2)
        Real vectors.

    Returns
    -------
    ndarray of complex, shape (...)
        x + iy.
    """
    return np.ascontiguousarray(vectors).view(complex)[..., 0]


def as_vectors(z: np.ndarray) -> np.ndarray:
    """Return complex numbers as vectors, the inverse of `as_complex`.

    Parameters
    ----------
    z : ndarray of complex, shape (...)
        x + iy.

    Returns
    -------
    ndarray, shape (..., 2)
        Real vectors.
    """
    return np.ascontiguousarray(z).view(float).reshape(*z.shape, 2)
