"""Rollers on a floor in a real field: a moment that the field drags round, and what rolls by it.

The moment of a sphere of low Reynolds number turns into the field B at the rate γ|B| sin δ, δ
being the angle between the two and γ its moment over the rotational drag (Stokes). In a field that
rotates it follows, behind by δ, as long as ω < γ|B|; beyond that it steps out and slips. Turning
about an axis in the plane it rolls along ω̂ × ẑ, as far per turn as the floor couples (Goldman, Cox
and Brenner, Chemical Engineering Science 22, 637 (1967)). A field that stands moves nothing.
"""

from __future__ import annotations

import math
from collections import deque

import numba
import numpy as np

from microbot_ros.virtual_rig.world import FieldHistory

_LONGEST_S = 2e-3
"""Of a row: a moment that turns into a field that stands takes some of them."""


class Rolling:
    """Turns what the coils make into rows by which a `World` of rollers moves.

    `mobility` γ [rad/(s T)] is the same for all of them. Its clock begins at 0 s.
    """

    def __init__(self, mobility: float) -> None:
        self._mobility = mobility
        self._moment = np.array([1.0, 0.0, 0.0])
        self._t = 0.0
        self._rows: deque[tuple[float, np.ndarray, float]] = deque([(-math.inf, np.zeros(2), 0.0)])

    def take(self, t: np.ndarray, field: np.ndarray, until: float) -> None:
        """Live on to `until` [s] in a `field` (K, 3) [T]; each row holds from `t` (K,) [s] on."""
        ends = np.append(t[1:], until)
        begin, end = np.clip(t, self._t, until), np.clip(ends, self._t, until)
        for start, stop, here in zip(begin, end, field, strict=True):
            count = math.ceil((stop - start) / _LONGEST_S)
            for k in range(count):
                self._turn(start + k * (stop - start) / count, (stop - start) / count, here)
        self._t = max(until, self._t)

    def history(self, since: float) -> FieldHistory:
        """The rows in force from `since` [s] on: how fast all roll, and which way."""
        while len(self._rows) > 1 and self._rows[1][0] <= since:
            self._rows.popleft()
        t, field, frequency = zip(*self._rows, strict=True)
        return FieldHistory(np.array(t), np.array(field)[:, None], np.array(frequency))

    def _turn(self, t: float, length: float, field: np.ndarray) -> None:
        turned = turn_moment(self._moment, field, self._mobility, length) / length
        across = math.hypot(turned[0], turned[1])
        direction = np.array([turned[1], -turned[0]]) / (across or 1.0)
        self._rows.append((t, math.hypot(*field) * direction, across / math.tau))


@numba.njit(cache=True)
def turn_moment(moment: np.ndarray, field: np.ndarray, mobility: float, length: float,
                ) -> np.ndarray:
    """By what angle (3,) [rad] a unit `moment` (3,), changed in place, turns into a `field` (3,).

    [T], with the `mobility` [rad/(s T)], in `length` [s]: dδ/dt = −γ|B| sin δ has the solution
    tan δ/2 ∝ exp(−γ|B|t). One that points straight against the field stays.
    """
    strength = math.sqrt(field[0] ** 2 + field[1] ** 2 + field[2] ** 2)
    angle = np.zeros(3)
    if not strength > 0:
        return angle
    axis = np.cross(moment, field / strength)
    sine = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    if sine < 1e-12:
        return angle
    axis /= sine
    before = math.atan2(sine, np.dot(moment, field) / strength)
    after = 2 * math.atan(math.tan(before / 2) * math.exp(-mobility * strength * length))
    across = np.cross(axis, moment)
    c, s = math.cos(before - after), math.sin(before - after)
    moment[:] = c * moment + s * across
    moment /= math.sqrt(moment[0] ** 2 + moment[1] ** 2 + moment[2] ** 2)
    angle[:] = (before - after) * axis
    return angle
