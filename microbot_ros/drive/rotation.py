"""Currents of a rotating field, sample by sample; pure, like the gate.

The field is the sum of a constant one and one of constant strength along a unit vector that
rotates about an axis. The vector is continuous through every change: for a new axis its component
across the axis is used, so that the phase has no step. Remaining steps of the currents (the field
has grown, the axis has tilted) are made up for no faster than the gate allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from microbot_ros.drive.amplifier import Swing

Vector = tuple[float, float, float]

_ALONG = 1e-9
"""Length of the component of a unit vector across an axis below which both are parallel. Choice:
far above rounding (1e-16), far below any angle that matters."""


@dataclass(frozen=True, eq=False)
class Turning:
    """Currents `steady` + `per_direction` times a rotating unit vector.

    Attributes
    ----------
    steady : ndarray, shape (N,)
        Constant currents [A].
    per_direction : ndarray, shape (N, 3)
        Currents [A] per unit vector along each axis.
    axis : ndarray, shape (3,)
        Unit vector of the axis.
    rate : float
        Angular velocity [rad/s], right-handed.
    start : ndarray, shape (3,)
        Unit vector at which the rotation begins, unless a rotation is in progress.
    driven : callable
        Function that returns the currents (N,) [A] that have the same effect if the core of a coil
        saturates.
    """

    steady: np.ndarray
    per_direction: np.ndarray
    axis: np.ndarray
    rate: float
    start: np.ndarray
    driven: Callable[[np.ndarray], np.ndarray] = np.asarray

    def at(self, direction: Vector | np.ndarray) -> np.ndarray:
        """Return the currents for a direction of the rotating vector.

        Parameters
        ----------
        direction : Vector or ndarray, shape (3,)
            Unit vector.

        Returns
        -------
        ndarray, shape (N,)
            Currents [A].
        """
        with np.errstate(invalid='ignore'):  # the gate reports values that are not finite
            return self.driven(self.steady + self.per_direction @ np.asarray(direction))


class Rotation:
    """Position of the rotating vector of a `Turning`.

    Parameters
    ----------
    slew_A_per_s : float
        Fastest rate [A/s] at which a step of the currents is made up for.
    """

    def __init__(self, slew_A_per_s: float) -> None:
        self._slew_A_per_s = slew_A_per_s
        self._turning: Turning | None = None
        self._direction: Vector = (math.nan,) * 3
        self._t = self._since = -math.inf
        self._jump = self._left = np.zeros(0)

    @property
    def turns(self) -> bool:
        """Whether a rotation is in progress."""
        return self._turning is not None

    @property
    def settled(self) -> bool:
        """Whether all steps had been made up for in the last sample."""
        return not self._left.any()

    def stop(self) -> None:
        """Stop; the next rotation begins anew."""
        self._turning = None

    def follow(self, turning: Turning, now_s: float, flowing_A: np.ndarray) -> None:
        """Continue with another rotation.

        It begins at the present direction of the rotation in progress, or else at `flowing_A`.

        Parameters
        ----------
        turning : Turning
            The new rotation.
        now_s : float
            Present time [s] of the monotonic clock.
        flowing_A : ndarray, shape (N,)
            Present currents [A].
        """
        direction: Vector = tuple(turning.start.tolist())
        if self._turning is not None:
            flowing_A = self.currents(now_s)
            direction = self._direction
        self._turning = turning
        self._direction = _across(direction, tuple(turning.axis.tolist()))
        self._t = self._since = now_s
        self._jump = self._left = flowing_A - turning.at(self._direction)

    def currents(self, now_s: float) -> np.ndarray:
        """Return the currents at a time.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        ndarray, shape (N,)
            Currents [A]; NaN, which no gate passes, if the axis is NaN.
        """
        assert self._turning is not None
        self._advance(now_s)
        made_up = self._slew_A_per_s * (now_s - self._since)
        self._left = np.sign(self._jump) * np.maximum(np.abs(self._jump) - made_up, 0.0)
        return self._turning.at(self._direction) + self._left

    def swing(self) -> Swing:
        """Return how the currents continue, for a device that rotates them by itself.

        Returns
        -------
        Swing
            From the last sample on. Exact once they have `settled`, if no core saturates.
        """
        turning = self._turning
        assert turning is not None
        (x, y, z), (a, b, d) = self._direction, turning.axis.tolist()
        ahead = (b * z - d * y, d * x - a * z, a * y - b * x)  # a quarter of a turn
        return Swing(turning.steady, turning.per_direction @ np.array((x, y, z)),
                     turning.per_direction @ np.array(ahead), turning.rate)

    def _advance(self, now_s: float) -> None:
        """Rotate about the axis by the angle since the last sample."""
        assert self._turning is not None
        angle = self._turning.rate * (now_s - self._t)
        c, s = math.cos(angle), math.sin(angle)
        (x, y, z), (a, b, d) = self._direction, self._turning.axis.tolist()
        turned = (c * x + s * (b * z - d * y), c * y + s * (d * x - a * z),
                  c * z + s * (a * y - b * x))
        self._direction = _across(turned, (a, b, d))  # rounding errors do not accumulate
        self._t = now_s


def _across(direction: Vector, axis: Vector) -> Vector:
    """Return the unit vector across a unit `axis` that is nearest to a unit `direction`.

    Any vector across the axis if the two are parallel.
    """
    (x, y, z), (a, b, d) = direction, axis
    along = x * a + y * b + z * d
    x, y, z = x - along * a, y - along * b, z - along * d
    length = math.sqrt(x * x + y * y + z * z)
    if length < _ALONG:
        return _across((1.0, 0.0, 0.0) if abs(a) < 0.6 else (0.0, 1.0, 0.0), axis)
    return x / length, y / length, z / length
