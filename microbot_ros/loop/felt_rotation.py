"""What rollers feel of a commanded rotation: all while the coils carry a field, else none."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.estimation.online.commands import NEGLIGIBLE, SET_BACK

Rotation = tuple[float, np.ndarray]
"""From when [s] on which angular velocity (2,) [rad/s]."""


class FeltRotation:
    """The last commanded rotation, and whether anything turns.

    A driver refuses commands that come late, and a gate that trips or was never armed lets nothing
    through, whatever is commanded meanwhile. Where no field was ever read back, the commanded
    rotation is taken for the one felt.
    """

    def __init__(self) -> None:
        self._commanded = np.zeros(2)
        self._flows = True
        self._t = -math.inf

    def command(self, t: float, angular_velocity: np.ndarray) -> Rotation:
        """What is felt once an angular velocity (2,) [rad/s] is commanded at `t` [s]."""
        self._commanded = angular_velocity
        return self._felt(t)

    def applied(self, t: float, field: np.ndarray) -> Rotation | None:
        """What is felt once a field (3,) [T] is read back at `t` [s]; None for no change.

        A reading that is not finite says nothing.
        """
        size = math.hypot(*field)
        flows = size >= NEGLIGIBLE
        if not math.isfinite(size) or flows == self._flows:
            return None
        self._flows = flows
        return self._felt(t)

    def _felt(self, t: float) -> Rotation:
        # Commands are stamped with the exposure they answer, readings with their own moment: the
        # two interleave, and what is felt goes forward; unless a replay begins again.
        if math.isfinite(t):
            t = self._t = t if t < self._t - SET_BACK else max(self._t, t)
        return t, self._commanded if self._flows else np.zeros(2)
