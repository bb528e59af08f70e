"""Rollers on a floor in a real field: rotation of their moments, and rolling.

The moment of a sphere at low Reynolds number turns into the field B at the rate γ|B| sin δ, with δ
the angle between them and γ the moment over the rotational drag (Stokes). In a rotating field it
follows with a lag δ as long as ω < γ|B|; beyond that it steps out and slips. Rotating about an
axis in the plane it rolls along ω̂ × ẑ, by a distance per turn that depends on the floor (Goldman,
Cox and Brenner, Chemical Engineering Science 22, 637 (1967)). A static field moves nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.compiled import numba
from microbot_ros.virtual_rig.world import FieldHistory

_LONGEST_S = 2e-3
"""Choice: longest row [s], several of which cover the alignment with a static field."""


class Rolling:
    """Converts the field of the coils into rows that move a `World` of rollers.

    `mobility` γ [rad/(s T)] is one value or (N,). The clock begins at 0 s.

    Parameters
    ----------
    mobility : ArrayLike
        Mobility γ [rad/(s T)], one value or (N,).
    """

    def __init__(self, mobility: ArrayLike) -> None:
        self._mobility = np.atleast_1d(np.asarray(mobility, dtype=float))
        count = len(self._mobility)
        self._moments = np.tile([1.0, 0.0, 0.0], (count, 1))
        self._before, self._turning = np.zeros(3), np.zeros(3)
        self._t = 0.0
        self._rows = FieldHistory(
            np.array([-math.inf]), np.zeros((1, count, 2)), np.zeros((1, count)))

    def take(self, t: np.ndarray, field: np.ndarray, until: float) -> None:
        """Advance to `until` [s] in a `field` (K, 3) [T]; each row holds from `t` (K,) [s] on.

        Parameters
        ----------
        t : ndarray, shape (K,)
            Times [s].
        field : ndarray, shape (K, 3)
            Fields [T].
        until : float
            Time at which to end [s].
        """
        begin = np.clip(t, self._t, max(until, self._t))
        length = np.diff(begin, append=max(until, self._t))
        count = np.ceil(length / _LONGEST_S).astype(int)
        length = np.repeat(length / np.maximum(count, 1), count)
        start = self._t + np.cumsum(length) - length
        made = _roll(self._moments, self._before, self._turning, self._mobility, length,
                     np.repeat(field, count, axis=0))
        before = self._rows
        assert before.frequency is not None
        self._rows = FieldHistory(*map(np.concatenate, (
            (before.t, start), (before.field, made[0]), (before.frequency, made[1]))))
        self._t = max(until, self._t)

    def history(self, since: float) -> FieldHistory:
        """Return frequency and direction of each roller in the rows from `since` [s] on.

        Earlier rows are forgotten.

        Parameters
        ----------
        since : float
            Time [s].

        Returns
        -------
        FieldHistory
            The rows.
        """
        rows = self._rows
        assert rows.frequency is not None
        first = max(int(np.searchsorted(rows.t, since, side='right')) - 1, 0)
        t, field, frequency = rows.t[first:], rows.field[first:], rows.frequency[first:]
        self._rows = FieldHistory(t, field, frequency)
        return FieldHistory(t, field, frequency if len(self._mobility) > 1 else frequency[:, 0])


@numba.njit(cache=True)
def _roll(moments: np.ndarray, before: np.ndarray, turning: np.ndarray, mobility: np.ndarray,
          length: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (R, N, 2), as long as the `field` (R, 3) [T], and frequencies (R, N) [Hz].

    Changes the `moments` (N, 3), of a `mobility` (N,), the previous field `before` (3,), and its
    last axis of rotation `turning` (3,). Row k lasts `length` [s]. A slipping roller that rolls
    back has a negative frequency.
    """
    way = np.zeros((len(length), len(moments), 2))
    frequency = np.zeros((len(length), len(moments)))
    for k in range(len(length)):
        here = field[k]
        axis = np.cross(before, here)
        if axis.any():
            turning[:] = axis
        before[:] = here
        strength = math.sqrt((here**2).sum())
        for n in range(len(moments)):
            turned = turn_moment(moments[n], here, mobility[n], length[k]) / length[k]
            across = math.sqrt(turned[0] ** 2 + turned[1] ** 2)
            if across > 0:
                sign = -1.0 if turned[0] * turning[0] + turned[1] * turning[1] < 0 else 1.0
                way[k, n, 0] = sign * strength * turned[1] / across
                way[k, n, 1] = -sign * strength * turned[0] / across
                frequency[k, n] = sign * across / math.tau
    return way, frequency


@numba.njit(cache=True)
def turn_moment(moment: np.ndarray, field: np.ndarray, mobility: float, length: float,
                ) -> np.ndarray:
    """Turn a unit `moment` (3,) towards a `field` (3,) [T] for `length` [s], in place.

    Returns the rotation vector (3,) [rad]. With the `mobility` γ [rad/(s T)], dδ/dt = −γ|B| sin δ
    has the solution tan δ/2 ∝ exp(−γ|B|t). A moment exactly against the field stays.

    Parameters
    ----------
    moment : ndarray, shape (3,)
        Unit vector, turned in place.
    field : ndarray, shape (3,)
        Field [T].
    mobility : float
        Mobility γ [rad/(s T)].
    length : float
        Duration [s].

    Returns
    -------
    ndarray, shape (3,)
        Rotation vector [rad].
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
