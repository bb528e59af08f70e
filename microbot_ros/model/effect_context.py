"""What an effect can look at: when, where the particles are, and the field they feel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

CLOSEST = 1e-6
"""Pair terms see no distance below this [m]: closer than any two of these spheres can come."""


Given = TypeVar('Given')


def _known(value: Given | None, what: str) -> Given:
    """The `value`; ValueError saying `what` is needed where there is none."""
    if value is None:
        raise ValueError(f'an effect of this model needs {what}; received none')
    return value


@dataclass(frozen=True)
class Places:
    """Where the particles are, `position` (..., N, 2) [m], NaN where one is missing.

    `number` (N,) integers and `direction` (N,) [rad], their φ, where it matters which they are.
    """

    position: np.ndarray
    number: np.ndarray | None = None
    direction: np.ndarray | None = None

    def led_by(self, lead: int) -> Places:
        """The same after `lead` spans more, in which particles are where they are at first."""
        before = np.repeat(self.position[:1], lead, axis=0)
        return Places(np.concatenate([before, self.position]), self.number, self.direction)

    @property
    def ids(self) -> np.ndarray:
        """The numbers (N,) of the particles; ValueError where they were not given."""
        return _known(self.number, 'to know which particle is which')

    @property
    def phi(self) -> np.ndarray:
        """φ (N,) [rad] of the particles; ValueError where it was not given."""
        return _known(self.direction, 'φ of the particles')

    @cached_property
    def separation(self) -> np.ndarray:
        """From neighbour j (last axis) to particle i, x + iy (..., N, N) [m]."""
        z = self.position[..., 0] + 1j * self.position[..., 1]
        return z[..., :, None] - z[..., None, :]

    @cached_property
    def _inverse_distance(self) -> np.ndarray:
        """1/r (..., N, N) [1/m], at most 1/CLOSEST.

        Zero for a particle and itself and where either is missing, so that neither acts.
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
        """Σⱼ e/r⁴ and Σⱼ e³/r⁴ (..., N) [m⁻⁴], e = e^{iα} from neighbour j towards particle i."""
        near = self._inverse_distance
        e = np.where(near > 0, self.separation, 0.0) * near
        return (near**4 * e).sum(axis=-1), (near**4 * (e * e * e)).sum(axis=-1)


@dataclass(frozen=True)
class EffectContext:
    """The state of the world in which effects are evaluated, at times of any shape (...).

    `t` (..., 1) [s] is the middle of a span of length `span` (..., 1) [s] over which effects may
    average (zero: at an instant); `field` (..., 1, 2) [T] is the field after stage 1, the same
    for all particles; `frequency` (..., 1) [Hz] the drive's rotation; `reference_field` [T];
    `since` (..., 1) [s] the time since the command last changed, None where nobody counts it.
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
        """|B| (..., 1) [T]."""
        return np.hypot(self.field[..., 0], self.field[..., 1])

    @property
    def position(self) -> np.ndarray:
        """Positions (..., N, 2) [m]; NaN where a particle is missing."""
        return self.known_places.position

    @property
    def known_places(self) -> Places:
        """The places, for effects that need them; ValueError where none were given."""
        return _known(self.places, 'positions')

    @property
    def since_switch(self) -> np.ndarray:
        """Time (..., 1) [s] since the command last changed; ValueError where nobody counts it."""
        return _known(self.since, 'the time since the command changed')

    def after(self, lead: int, places: Places | None = None) -> EffectContext:
        """The context without its first `lead` times, at these places."""
        return self._select(slice(lead, None), places)

    def at(self, k: int, places: Places) -> EffectContext:
        """The context at the k-th of its times, at these places."""
        return self._select(k, places)

    def _select(self, times: int | slice, places: Places | None) -> EffectContext:
        return EffectContext(
            self.t[times], self.span[times], self.field[times], self.frequency[times],
            self.reference_field, places, None if self.since is None else self.since[times],
        )
