"""Currents of a field that turns, sample by sample; pure, as the gate is.

The field is a steady one and one of constant strength along a unit vector that turns about an
axis. What carries on through every change is that vector: a new axis takes of it what lies across,
so that the phase has no step, and what the currents jump even so (the field has grown, the axis
has tipped) is made up for no faster than the gate allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from microbot_ros.drive.amplifier import Swing

Vector = tuple[float, float, float]

_ALONG = 1e-9
"""Of a unit vector: what lies across an axis is less than this where they are parallel."""


@dataclass(frozen=True, eq=False)
class Turning:
    """`steady` (N,) [A] and `per_direction` (N, 3) [A] times a unit vector that turns.

    About `axis` (3,), a unit vector, at `rate` [rad/s], right-handed; it begins at `start` (3,)
    unless one turns already. `driven` are the currents (N,) that are worth so much, where the core
    of a coil saturates.
    """

    steady: np.ndarray
    per_direction: np.ndarray
    axis: np.ndarray
    rate: float
    start: np.ndarray
    driven: Callable[[np.ndarray], np.ndarray] = np.asarray

    def at(self, direction: Vector | np.ndarray) -> np.ndarray:
        """The currents (N,) [A] for a `direction` (3,) of what turns."""
        with np.errstate(invalid='ignore'):  # the gate tells what is not finite
            return self.driven(self.steady + self.per_direction @ np.asarray(direction))


class Rotation:
    """Where the vector of a `Turning` is. `slew_A_per_s` bounds how fast a jump is made up for."""

    def __init__(self, slew_A_per_s: float) -> None:
        self._slew_A_per_s = slew_A_per_s
        self._turning: Turning | None = None
        self._direction: Vector = (math.nan,) * 3
        self._t = self._since = -math.inf
        self._jump = self._left = np.zeros(0)

    @property
    def turns(self) -> bool:
        """Whether anything does."""
        return self._turning is not None

    @property
    def settled(self) -> bool:
        """Whether all jumps had been made up for in the last sample."""
        return not self._left.any()

    def stop(self) -> None:
        """The next one begins anew."""
        self._turning = None

    def follow(self, turning: Turning, now_s: float, flowing_A: np.ndarray) -> None:
        """Go on with another `turning` from `now_s` on.

        It begins at what turned until now, or else at `flowing_A` (N,) [A].
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
        """The currents (N,) [A] at `now_s`; NaN, which no gate lets pass, where the axis is."""
        assert self._turning is not None
        self._advance(now_s)
        made_up = self._slew_A_per_s * (now_s - self._since)
        self._left = np.sign(self._jump) * np.maximum(np.abs(self._jump) - made_up, 0.0)
        return self._turning.at(self._direction) + self._left

    def swing(self) -> Swing:
        """How the currents of the last sample go on, for a device that turns them by itself.

        Exact once they have `settled`, where no core saturates.
        """
        turning = self._turning
        assert turning is not None
        (x, y, z), (a, b, d) = self._direction, turning.axis.tolist()
        ahead = (b * z - d * y, d * x - a * z, a * y - b * x)  # a quarter of a turn
        return Swing(turning.steady, turning.per_direction @ np.array((x, y, z)),
                     turning.per_direction @ np.array(ahead), turning.rate)

    def _advance(self, now_s: float) -> None:
        """Turn about the axis by what the time since the last sample makes."""
        assert self._turning is not None
        angle = self._turning.rate * (now_s - self._t)
        c, s = math.cos(angle), math.sin(angle)
        (x, y, z), (a, b, d) = self._direction, self._turning.axis.tolist()
        turned = (c * x + s * (b * z - d * y), c * y + s * (d * x - a * z),
                  c * z + s * (a * y - b * x))
        self._direction = _across(turned, (a, b, d))  # rounding does not add up
        self._t = now_s


def _across(direction: Vector, axis: Vector) -> Vector:
    """The unit vector across a unit `axis` that is nearest to a unit `direction`; any across it
    where the two are parallel.
    """
    (x, y, z), (a, b, d) = direction, axis
    along = x * a + y * b + z * d
    x, y, z = x - along * a, y - along * b, z - along * d
    length = math.sqrt(x * x + y * y + z * z)
    if length < _ALONG:
        return _across((1.0, 0.0, 0.0) if abs(a) < 0.6 else (0.0, 1.0, 0.0), axis)
    return x / length, y / length, z / length
