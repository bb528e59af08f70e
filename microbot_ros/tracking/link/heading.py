"""Front and back of elongated bodies: the outline gives the axis, the motion the front."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.tracking.link.states import TrackStates

_MEMORY = 100.0
"""Choice: frames over which the motion along the axis is averaged."""

_ENOUGH = 1.0
"""Choice: widths travelled backwards after which front and back are swapped."""


def orient(states: TrackStates, rows: np.ndarray, step: np.ndarray) -> None:
    """Point `theta` of the `rows` (K,) of `states`, known up to half a turn, at the tail.

    An axis never turns by more than a quarter between frames; the front is the direction of
    average motion, `step` (K, 2) [px] being the last displacement. The tail corresponds to the cap
    of a sphere: behind. θ is between 0 and 2π.

    Parameters
    ----------
    states : TrackStates
        States of the particles.
    rows : ndarray, shape (K,)
        Rows of the particles.
    step : ndarray, shape (K, 2)
        Last displacements [px].
    """
    theta, before = states.theta[rows], states.tail[rows]
    theta = np.where(np.cos(theta - before) < 0, theta + math.pi, theta)
    ahead = -(step[:, 0] * np.cos(theta) + step[:, 1] * np.sin(theta))
    shown = np.isfinite(theta)
    along = states.along[rows]
    along[shown] = along[shown] * (1 - 1 / _MEMORY) + ahead[shown]
    backwards = along < -_ENOUGH * 2 * states.radius[rows]
    states.along[rows] = np.where(backwards, -along, along)
    states.theta[rows] = np.mod(theta + np.where(backwards, math.pi, 0.0), math.tau)
    states.tail[rows] = np.where(shown, states.theta[rows], before)
