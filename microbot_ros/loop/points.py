"""Data types between the stages of the loop: rows of single-precision numbers.

Topics carry the same bytes, so that the loop gives the same commands to the last bit in one
process or in four, live or replayed.
"""

from __future__ import annotations

import numpy as np

PARTICLE = np.dtype([
    ('id', '<u4'), ('x', '<f4'), ('y', '<f4'), ('theta', '<f4'), ('vx', '<f4'), ('vy', '<f4'),
    ('sigma', '<f4'),
])
"""Particle seen in one frame, a point of `particles`. SI units; `theta` and velocity are NaN if
unknown.
"""

ESTIMATE = np.dtype([
    ('id', '<u4'), ('x', '<f4'), ('y', '<f4'), ('speed', '<f4'), ('phi', '<f4'),
    ('force', '<f4'), ('x_std', '<f4'), ('y_std', '<f4'), ('speed_std', '<f4'),
    ('phi_std', '<f4'), ('force_std', '<f4'), ('x_ahead', '<f4'), ('y_ahead', '<f4'),
    ('ahead_std', '<f4'), ('theta', '<f4'),
])
"""Estimated state of a particle, a point of `model/state`.

SI units, NaN if not yet known. `*_ahead` is one prediction horizon later, `theta` the heading
measured in the frame.
"""

GOAL = np.dtype([('id', '<u4'), ('x', '<f4'), ('y', '<f4')])
"""Goal of one particle [m], a point of `particle_goals`."""

PLACE = np.dtype([('x', '<f4'), ('y', '<f4')])
"""Goal for any particle [m], a point of `controller/goals` if goals have no ids."""


def numbers(points: np.ndarray) -> np.ndarray:
    """Return all fields but `id` of `points` (N,) in double precision, (F, N), a row per field.

    Parameters
    ----------
    points : ndarray, shape (N,)
        Structured array.

    Returns
    -------
    ndarray, shape (F, N)
        Numbers, one row per field.
    """
    rows = np.ascontiguousarray(points).view('<f4').reshape(-1, points.itemsize // 4)
    return rows.T[1:].astype(float, order='C')


def particles_at(ids: np.ndarray, position: np.ndarray, sigma: float) -> np.ndarray:
    """Return particles (N,) of type PARTICLE with known `ids` (N,) and `position` (N, 2) [m] only.

    `sigma` [m] is the standard deviation of each coordinate.

    Parameters
    ----------
    ids : ndarray, shape (N,)
        Identities.
    position : ndarray, shape (N, 2)
        Positions [m].
    sigma : float
        Standard deviation of each coordinate [m].

    Returns
    -------
    ndarray, shape (N,)
        PARTICLE of each particle.
    """
    points = np.zeros(len(ids), PARTICLE)
    points['id'], points['sigma'] = ids, sigma
    points['x'], points['y'] = np.reshape(position, (-1, 2)).T
    for name in ('theta', 'vx', 'vy'):
        points[name] = np.nan
    return points
