"""The simulated world: many particles in a field, moved by fine Langevin steps.

On purpose the one other place in the project that moves particles: it integrates torques,
flows and forces at a millisecond, so that what it makes tests the equations of `model`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.records import Commands
from microbot_ros.model.physics.langevin import step_grid
from microbot_ros.virtual_rig.coil_gradients import coil_gradients
from microbot_ros.virtual_rig.dynamics import advance


@dataclass(frozen=True)
class FieldHistory:
    """The field over time; each row holds until the next, and before the first there is none.

    `t` (K,) [s], ascending; `field` (K, N, 2) [T] at each particle, or (K, 1, 2) the same for
    all; `frequency` (K,) [Hz] of a rolling field, (K, N) of what each particle makes of it, or
    None.
    """

    t: np.ndarray
    field: np.ndarray
    frequency: np.ndarray | None = None

    @property
    def turns(self) -> np.ndarray:
        """The frequency (K, 1), or (K, N) where each has its own [Hz]; 0 where nothing turns."""
        if self.frequency is None:
            return np.zeros((len(self.t), 1))
        return self.frequency if self.frequency.ndim == 2 else self.frequency[:, None]

    @classmethod
    def uniform(cls, commands: Commands) -> FieldHistory:
        """The same field everywhere."""
        return cls(commands.t, commands.field[:, None, :], commands.frequency)


class World:
    """Particles and their clock.

    `bodies` (N,) of type BODY (see `body.bodies`) hold state and properties and change in
    place; `rng` drives all chance. `half_extent` (2,) [m], where given, keeps the particles
    between walls at ± that distance from the origin: they stop at a wall and slide along it.
    `walls` (W, 4) [m] are others, thin and straight: x, y, x, y of their ends. Spheres never
    overlap. `touched` (N,) says which have met another or one of the `walls`. The clock `t` [s]
    starts at zero.
    """

    def __init__(
        self, bodies: np.ndarray, rng: np.random.Generator,
        half_extent: tuple[float, float] = (math.inf, math.inf),
        walls: ArrayLike = (),
    ) -> None:
        self.bodies = bodies
        self.t = 0.0
        self._rng = rng
        self._half_extent = np.array(half_extent, dtype=float)
        self._walls = np.array(walls, dtype=float).reshape(-1, 4)
        self.touched = np.zeros(len(bodies), bool)

    @property
    def position(self) -> np.ndarray:
        """Where the particles are now (N, 2) [m], a copy."""
        position = np.empty((len(self.bodies), 2))
        position[:, 0], position[:, 1] = self.bodies['x'], self.bodies['y']
        return position

    @property
    def heading(self) -> np.ndarray:
        """Where they head now (N,) [rad], a copy, continuous over turns."""
        return self.bodies['heading'].copy()

    def advance(self, until: float, history: FieldHistory) -> np.ndarray:
        """Move on to the time `until` [s]; the mean position (N, 2) [m] on the way.

        The mean is what a camera sees whose shutter is open for that time. Steps are at most
        1 ms, and each takes the row of the history in force at its middle, `delay` earlier for
        a particle that has one: keep rows that old. A time not after the present returns the
        present.
        """
        if until <= self.t:
            return self.position
        middle, length = step_grid(self.t, until)
        mean = np.zeros((len(self.bodies), 2))
        advance(
            self.bodies, middle, length, np.asarray(history.t, dtype=float),
            np.ascontiguousarray(history.field, dtype=float),
            np.ascontiguousarray(history.turns, dtype=float), coil_gradients(),
            self._half_extent, self._walls, self._rng, mean, self.touched,
        )
        self.t = until
        return mean

    def observe(self, position: np.ndarray) -> np.ndarray:
        """What the camera makes of positions (N, 2) [m] beyond what the bodies say of it."""
        return position
