"""Front and back of what is longer than wide: the outline tells its axis, its way the front."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.tracking.link.states import TrackStates

_MEMORY = 100.0
"""Frames over which the way of a body along its axis counts."""

_ENOUGH = 1.0
"""Widths: who has gone so far backwards has its front there."""


def orient(states: TrackStates, rows: np.ndarray, step: np.ndarray) -> None:
    """Turn `theta` of those `rows` (K,) of `states`, known up to half a turn, to the tail.

    An axis goes on where it was, and never turns by more than a quarter from frame to frame; the
    front is where it went, on the whole: `step` (K, 2) [px] is the last part of its way. A tail
    is what a cap is of a sphere: behind. θ is between 0 and 2π.
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
