"""Ways to command a uniform field: in steps, turning, or by what the camera sees."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.model.physics.vectors import unit

Levels = float | Sequence[float] | np.ndarray
ROTATING_HZ = 20.0
"""How often a turning field is commanded."""

def steps(
    rng: np.random.Generator, duration: float, field: Levels, dwell: tuple[float, float],
    centre: float = 0.0, spread: float = math.pi, frequency: Levels | None = None,
) -> Commands:
    """Directions drawn evenly within ± `spread` of `centre` [rad], each held for a while.

    The whiles, drawn evenly from `dwell` [s], fill `duration` [s]; `field` [T] and, for rollers,
    `frequency` [Hz] are one level or several to draw from with every step. The paper's legs are
    `dwell=(2, 6)`.
    """
    most = math.ceil(duration / dwell[0])
    begin = np.concatenate(([0.0], np.cumsum(rng.uniform(*dwell, most))))
    begin = begin[begin < duration]
    count = len(begin)
    direction = rng.uniform(centre - spread, centre + spread, count)
    strength = rng.choice(np.atleast_1d(field), count)
    turns = None if frequency is None else rng.choice(np.atleast_1d(frequency), count)
    return Commands(begin, strength[:, None] * unit(direction), turns)


def rotating(duration: float, field: float, period: float) -> Commands:
    """A `field` [T] turning anticlockwise once in `period` [s], set anew 20 times a second.

    For `duration` [s].
    """
    begin = np.arange(0.0, duration, 1 / ROTATING_HZ)
    return Commands(begin, field * unit(2 * math.pi * begin / period))


class Herding:
    """Feedback: bring the particle that strayed furthest back to the middle, then the next.

    Decides on the noisy positions that the camera reports, so command and noise are tied as in any
    closed loop. `phi` (N,) [rad] are its ideas of the particles' offsets; the strength of its
    `field` [T] is constant; it stays with one particle for `patience` [s].
    """

    def __init__(self, phi: np.ndarray, field: float, patience: float = 2.0) -> None:
        self._phi = phi
        self._field = field
        self._patience = patience
        self._chosen = 0
        self._until = -math.inf

    def __call__(self, t: float, seen: np.ndarray) -> np.ndarray:
        """The field (2,) [T] for the positions `seen` (N, 2) [m], NaN where one was missed."""
        distance = np.hypot(*seen.T)
        if t >= self._until and np.isfinite(distance).any():
            self._chosen = int(np.nanargmax(distance))
            self._until = t + self._patience
        if not np.isfinite(distance[self._chosen]):
            return np.zeros(2)
        x, y = seen[self._chosen]
        return self._field * unit(math.atan2(-y, -x) - self._phi[self._chosen])
