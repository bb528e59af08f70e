"""Simulated world: many particles in a field, moved by fine Langevin steps.

This is on purpose a second implementation of the motion: it integrates torques, flows and forces
at a millisecond, so that it tests the equations of `model`.
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
    """Field over time; each row holds until the next, and there is none before the first.

    Attributes
    ----------
    t : (K,) array [s]
        Ascending.
    field : (K, N, 2) or (K, 1, 2) array [T]
        At each particle, or the same for all.
    frequency : (K,) or (K, N) array [Hz], or None
        Of a rolling field, or of each particle.
    """

    t: np.ndarray
    field: np.ndarray
    frequency: np.ndarray | None = None

    @property
    def turns(self) -> np.ndarray:
        """Frequency (K, 1) or (K, N) [Hz]; 0 without rotation."""
        if self.frequency is None:
            return np.zeros((len(self.t), 1))
        return self.frequency if self.frequency.ndim == 2 else self.frequency[:, None]

    @classmethod
    def uniform(cls, commands: Commands) -> FieldHistory:
        """Return a field of `commands` that is equal everywhere.

        Parameters
        ----------
        commands : Commands
            The commands.

        Returns
        -------
        FieldHistory
            The history.
        """
        return cls(commands.t, commands.field[:, None, :], commands.frequency)


class World:
    """Particles and their clock, which starts at 0 s.

    Spheres never overlap. `touched` (N,) tells which have met another or one of the `walls`.

    Parameters
    ----------
    bodies : (N,) array of BODY
        State and properties, changed in place; see `body.bodies`.
    rng : Generator
        Source of random numbers.
    half_extent : (float, float) [m]
        Walls at ± this distance from the origin; particles stop at a wall and slide along it.
    walls : (W, 4) array [m]
        Thin straight walls: x, y, x, y of their ends.
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
        """Positions of the particles (N, 2) [m], a copy."""
        position = np.empty((len(self.bodies), 2))
        position[:, 0], position[:, 1] = self.bodies['x'], self.bodies['y']
        return position

    @property
    def heading(self) -> np.ndarray:
        """Headings of the particles (N,) [rad], a copy, continuous over turns."""
        return self.bodies['heading'].copy()

    def advance(self, until: float, history: FieldHistory) -> np.ndarray:
        """Advance to the time `until` [s]; return the mean position (N, 2) [m] meanwhile.

        The mean is what a camera with an open shutter sees. Steps are at most 1 ms; each uses the
        row of the `history` in force at its middle, `delay` earlier for a particle that has one:
        keep rows that old. A time not after the present returns the present positions.

        Parameters
        ----------
        until : float
            Time at which to end [s].
        history : FieldHistory
            The field.

        Returns
        -------
        ndarray, shape (N, 2)
            Mean positions [m].
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
        """Return positions (N, 2) [m] as the camera shows them, beyond effects in the bodies.

        Parameters
        ----------
        position : ndarray, shape (N, 2)
            Positions [m].

        Returns
        -------
        ndarray, shape (N, 2)
            Observed positions [m].
        """
        return position
