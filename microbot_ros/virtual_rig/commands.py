"""Commands of a uniform field: random steps, rotation, or feedback from the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.model.physics.vectors import unit

Levels = float | Sequence[float] | np.ndarray
ROTATING_HZ = 20.0
"""Choice: rate at which a rotating field is commanded."""

def steps(
    rng: np.random.Generator, duration: float, field: Levels, dwell: tuple[float, float],
    centre: float = 0.0, spread: float = math.pi, frequency: Levels | None = None,
) -> Commands:
    """Draw directions evenly within ± `spread` of `centre`, each held for a random time.

    The paper's legs are `dwell=(2, 6)`.

    Parameters
    ----------
    rng : Generator
        Source of random numbers.
    duration : float [s]
        Duration of all commands together.
    field : float or sequence [T]
        One level, or several to draw from at every step.
    dwell : (float, float) [s]
        Shortest and longest time, drawn evenly.
    centre, spread : float [rad]
        Middle of the directions, and largest deviation from it.
    frequency : float or sequence, optional [Hz]
        For rollers, as `field`.

    Returns
    -------
    Commands
        The commands.
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
    """Return a `field` [T] that turns anticlockwise once per `period` [s] for `duration` [s].

    It is set 20 times a second.

    Parameters
    ----------
    duration : float
        Duration [s].
    field : float
        Strength of the field [T].
    period : float
        Time of a turn [s].

    Returns
    -------
    Commands
        The commands.
    """
    begin = np.arange(0.0, duration, 1 / ROTATING_HZ)
    return Commands(begin, field * unit(2 * math.pi * begin / period))


class Herding:
    """Feedback that steers the particle furthest from the centre back, then the next.

    It uses the noisy positions of the camera, so that command and noise are correlated as in any
    closed loop. `phi` (N,) [rad] are the assumed offsets of the particles; the strength of the
    `field` [T] is constant; it stays with one particle for `patience` [s].

    Parameters
    ----------
    phi : ndarray, shape (N,)
        Offsets of the particles [rad].
    field : float
        Strength of the field [T].
    patience : float
        Time [s] for which it stays with a particle.
    """

    def __init__(self, phi: np.ndarray, field: float, patience: float = 2.0) -> None:
        self._phi = phi
        self._field = field
        self._patience = patience
        self._chosen = 0
        self._until = -math.inf

    def __call__(self, t: float, seen: np.ndarray) -> np.ndarray:
        """Return the field (2,) [T] for positions `seen` (N, 2) [m], NaN if missed, at `t` [s]."""
        distance = np.hypot(*seen.T)
        if t >= self._until and np.isfinite(distance).any():
            self._chosen = int(np.nanargmax(distance))
            self._until = t + self._patience
        if not np.isfinite(distance[self._chosen]):
            return np.zeros(2)
        x, y = seen[self._chosen]
        return self._field * unit(math.atan2(-y, -x) - self._phi[self._chosen])
