"""What effects depend on: times, places of particles, and the field that they feel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

CLOSEST = 1e-6
"""Distance [m] below which pair interactions are constant.

Choice: centres of spheres in use are never so close; it avoids division by zero.
"""


Given = TypeVar('Given')


def _known(value: Given | None, what: str) -> Given:
    """Return the `value`; raise ValueError that says `what` is needed if it is None."""
    if value is None:
        raise ValueError(f'an effect of this model needs {what}; received none')
    return value


@dataclass(frozen=True)
class Places:
    """Places of N particles.

    Attributes
    ----------
    position : ndarray, shape (..., N, 2)
        Positions [m]; NaN for a missing particle.
    number : ndarray of int, shape (N,), or None
        Ids, for terms that differ between particles.
    direction : ndarray, shape (N,), or None
        φ [rad], for terms that depend on the heading.
    """

    position: np.ndarray
    number: np.ndarray | None = None
    direction: np.ndarray | None = None

    def led_by(self, lead: int) -> Places:
        """Prepend spans in which particles stay at their first places.

        Parameters
        ----------
        lead : int
            Number of spans.

        Returns
        -------
        Places
            With `lead` more spans.
        """
        before = np.repeat(self.position[:1], lead, axis=0)
        return Places(np.concatenate([before, self.position]), self.number, self.direction)

    @property
    def ids(self) -> np.ndarray:
        """Ids (N,) of the particles; ValueError if they were not given."""
        return _known(self.number, 'to know which particle is which')

    @property
    def phi(self) -> np.ndarray:
        """φ (N,) [rad] of the particles; ValueError if it was not given."""
        return _known(self.direction, 'φ of the particles')

    @cached_property
    def separation(self) -> np.ndarray:
        """Vector from neighbour j (last axis) to particle i, x + iy (..., N, N) [m]."""
        z = self.position[..., 0] + 1j * self.position[..., 1]
        return z[..., :, None] - z[..., None, :]

    @cached_property
    def _inverse_distance(self) -> np.ndarray:
        """1/r (..., N, N) [1/m], at most 1/CLOSEST.

        Zero for a particle and itself, and if either is missing, so that neither acts.
        """
        distance = np.abs(self.separation)
        distance[~np.isfinite(distance)] = np.inf
        return ~np.eye(distance.shape[-1], dtype=bool) / np.maximum(distance, CLOSEST)

    @cached_property
    def nearness(self) -> np.ndarray:
        """Σⱼ 1/rᵢⱼ (..., N) [1/m] over the neighbours of each particle."""
        return self._inverse_distance.sum(axis=-1)

    @cached_property
    def dipole_sums(self) -> tuple[np.ndarray, np.ndarray]:
        """Σⱼ e/r⁴ and Σⱼ e³/r⁴ (..., N) [m⁻⁴], e = e^{iα} from neighbour j to particle i."""
        near = self._inverse_distance
        e = np.where(near > 0, self.separation, 0.0) * near
        return (near**4 * e).sum(axis=-1), (near**4 * (e * e * e)).sum(axis=-1)


@dataclass(frozen=True)
class EffectContext:
    """State of the world at which effects are evaluated, at times of any shape (...).

    Attributes
    ----------
    t : ndarray, shape (..., 1)
        Middle of a span [s].
    span : ndarray, shape (..., 1)
        Length of the span [s] over which effects may average; 0 for an instant.
    field : ndarray, shape (..., 1, 2)
        Field after stage 1 [T], the same for all particles.
    frequency : ndarray, shape (..., 1)
        Rotation of the drive [Hz].
    reference_field : float
        Field at which alignment times are stated [T].
    places : Places or None
        Places of the particles.
    since : ndarray, shape (..., 1), or None
        Time since the command last changed [s]; None if it is not computed.
    """

    t: np.ndarray
    span: np.ndarray
    field: np.ndarray
    frequency: np.ndarray
    reference_field: float
    places: Places | None = None
    since: np.ndarray | None = None

    @cached_property
    def strength(self) -> np.ndarray:
        """Strength of the field |B| (..., 1) [T]."""
        return np.hypot(self.field[..., 0], self.field[..., 1])

    @property
    def position(self) -> np.ndarray:
        """Positions (..., N, 2) [m]; NaN for a missing particle."""
        return self.known_places.position

    @property
    def known_places(self) -> Places:
        """The places, for effects that need them; ValueError if none were given."""
        return _known(self.places, 'positions')

    @property
    def since_switch(self) -> np.ndarray:
        """Time (..., 1) [s] since the command last changed; ValueError if it is not computed."""
        return _known(self.since, 'the time since the command changed')

    def after(self, lead: int, places: Places | None = None) -> EffectContext:
        """Return the context without its first times.

        Parameters
        ----------
        lead : int
            Number of times that are removed.
        places : Places, optional
            New places.

        Returns
        -------
        EffectContext
            The later times.
        """
        return self._select(slice(lead, None), places)

    def at(self, k: int, places: Places) -> EffectContext:
        """Return the context at one of its times.

        Parameters
        ----------
        k : int
            Index of the time.
        places : Places
            New places.

        Returns
        -------
        EffectContext
            The k-th time.
        """
        return self._select(k, places)

    def _select(self, times: int | slice, places: Places | None) -> EffectContext:
        return EffectContext(
            self.t[times], self.span[times], self.field[times], self.frequency[times],
            self.reference_field, places, None if self.since is None else self.since[times],
        )
