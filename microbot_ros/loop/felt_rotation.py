"""Rotation that acts on rollers: the commanded one while the coils carry a field, else none."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.estimation.online.commands import NEGLIGIBLE, SET_BACK

Rotation = tuple[float, np.ndarray]
"""Start time [s] and angular velocity (2,) [rad/s]."""


class FeltRotation:
    """The last commanded rotation, and whether the coils carry a field.

    A driver refuses late commands, and a gate that has tripped or was never armed passes nothing,
    whatever is commanded. Until a field is read back, the commanded rotation counts as acting.
    """

    def __init__(self) -> None:
        self._commanded, self._commanded_t = np.zeros(2), -math.inf
        self._flows = True
        self._t = -math.inf

    def command(self, t: float, angular_velocity: np.ndarray) -> Rotation | None:
        """Return the rotation acting once an angular velocity is commanded.

        Parameters
        ----------
        t : float
            Time of the command [s]. A command from before the newest one is superseded.
        angular_velocity : ndarray, shape (2,)
            Angular velocity [rad/s], zero for a field that stands.

        Returns
        -------
        Rotation or None
            None if nothing changes: the command is superseded, or the field stood before and
            stands now.
        """
        superseded = self._commanded_t - SET_BACK < t < self._commanded_t
        if superseded or not (angular_velocity.any() or self._commanded.any()):
            return None
        self._commanded = angular_velocity
        if math.isfinite(t):
            self._commanded_t = t
        return self._felt(t)

    def applied(self, t: float, field: np.ndarray) -> Rotation | None:
        """Return the rotation once a `field` (3,) [T] is read at `t` [s]; None if unchanged.

        A reading that is not finite is ignored.

        Parameters
        ----------
        t : float
            Time [s].
        field : ndarray, shape (3,)
            Field that is read back [T].

        Returns
        -------
        Rotation or None
            The rotation, or None.
        """
        size = math.hypot(*field)
        flows = size >= NEGLIGIBLE
        if not math.isfinite(size) or flows == self._flows:
            return None
        self._flows = flows
        return self._felt(t)

    def _felt(self, t: float) -> Rotation:
        # Commands carry the time of the exposure they answer, readings their own, so the two
        # interleave. Time must not go back here, unless a replay starts again.
        if math.isfinite(t):
            t = self._t = t if t < self._t - SET_BACK else max(self._t, t)
        return t, self._commanded if self._flows else np.zeros(2)
