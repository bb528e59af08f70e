"""What one stage of the loop hands to the next: rows of single-precision numbers.

On the topics lie the same bytes, so that the loop gives the same commands to the last bit whether
its stages run in one process or in four, live or from a recording.
"""

from __future__ import annotations

import numpy as np

PARTICLE = np.dtype([
    ('id', '<u4'), ('x', '<f4'), ('y', '<f4'), ('theta', '<f4'), ('vx', '<f4'), ('vy', '<f4'),
    ('sigma', '<f4'),
])
"""A particle as seen in one frame, a point of `particles`: SI, `theta` and velocity NaN where they
are not known."""

ESTIMATE = np.dtype([
    ('id', '<u4'), ('x', '<f4'), ('y', '<f4'), ('speed', '<f4'), ('phi', '<f4'),
    ('force', '<f4'), ('x_std', '<f4'), ('y_std', '<f4'), ('speed_std', '<f4'),
    ('phi_std', '<f4'), ('force_std', '<f4'), ('x_ahead', '<f4'), ('y_ahead', '<f4'),
    ('ahead_std', '<f4'), ('theta', '<f4'),
])
"""What is known of a particle, a point of `model/state`: SI; NaN for what is not known yet.
`*_ahead`: a horizon later. `theta` is the heading that the tracker saw in that frame."""

GOAL = np.dtype([('id', '<u4'), ('x', '<f4'), ('y', '<f4')])
"""Where one particle is to go [m], a point of `particle_goals`."""

PLACE = np.dtype([('x', '<f4'), ('y', '<f4')])
"""Where to go [m], whoever goes there: a point of `controller/goals` where goals have no ids."""


def numbers(points: np.ndarray) -> np.ndarray:
    """All of `points` (N,), of one of these types, but their ids: (F, N) double precision, a row
    for each field.
    """
    rows = np.ascontiguousarray(points).view('<f4').reshape(-1, points.itemsize // 4)
    return rows.T[1:].astype(float, order='C')


def particles_at(ids: np.ndarray, position: np.ndarray, sigma: float) -> np.ndarray:
    """Particles (N,) of type PARTICLE of which only `position` (N, 2) [m] is known, and `sigma`
    [m], its standard deviation per axis; `ids` (N,).
    """
    points = np.zeros(len(ids), PARTICLE)
    points['id'], points['sigma'] = ids, sigma
    points['x'], points['y'] = np.reshape(position, (-1, 2)).T
    for name in ('theta', 'vx', 'vy'):
        points[name] = np.nan
    return points
