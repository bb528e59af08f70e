"""A term that was learned from data: a table of one covariate, where no effect has a name for it.

It acts as an effect does, on the velocity, the speed or the heading, and holds nothing but
numbers: values at knots of the covariate, linear between them. Beyond the region in which it was
learned it fades to nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from microbot_ros.model.effect_context import EffectContext

Against = Literal[
    'position', 'time', 'time since switch', 'command angle', 'heading', 'field strength',
    'frequency', 'neighbour distance', 'particle']
Frame = Literal['laboratory', 'heading', 'radial']
ActsOn = Literal['velocity', 'speed', 'heading']
COVARIATES: tuple[str, ...] = get_args(Against)

AXES: dict[str, tuple[str, ...]] = {
    'position': ('x_um', 'y_um'),
    'time': ('time_s',),
    'time since switch': ('since_switch_s',),
    'command angle': ('angle_rad',),
    'heading': ('angle_rad',),
    'field strength': ('field_mT',),
    'frequency': ('frequency_hz',),
    'neighbour distance': ('distance_um',),
    'particle': ('particle',),
}
"""What the knots of each covariate are called in files, with their unit."""

VALUES: dict[tuple[str, str], tuple[str, ...]] = {
    ('laboratory', 'velocity'): ('x_um_s', 'y_um_s'),
    ('radial', 'velocity'): ('away_um_s', 'around_um_s'),
    ('heading', 'speed'): ('factor',),
    ('radial', 'speed'): ('factor',),
    ('heading', 'heading'): ('turn_rad',),
}
"""What values are called, by the frame and what the term acts on: which pairs there are."""

PERIODIC = ('command angle', 'heading')
"""Covariates that are the same again a turn on; their knots divide the turn equally."""


@dataclass(frozen=True)
class LearnedTerm:
    """A table of what is missing `against` a covariate, in a `frame`, of what it `acts_on`.

    `axes`: the knots (K,) of the covariate, ascending, in SI; of a position those of x and those
    of y, which make a grid. `values` (K, C), for a grid x by x: of a velocity its x and y [m/s],
    or away from a neighbour and around it, anticlockwise, summed over neighbours; of a speed what
    is added to the factor 1, by each neighbour in the frame `radial`; of a heading the angle that
    is added [rad]. `low`, `high` (K, C): the 95 % band. `seen` (K,): whether data were there; the
    values fade to nothing beyond. `formula` and its `parameters`, where one was found that
    explains as much: told to people, the table is what acts.
    """

    against: Against
    frame: Frame
    acts_on: ActsOn
    axes: tuple[np.ndarray, ...]
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seen: np.ndarray
    formula: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, LearnedTerm):
            return NotImplemented
        arrays = zip((*self.axes, self.values, self.low, self.high, self.seen),
                     (*other.axes, other.values, other.low, other.high, other.seen), strict=False)
        return self._said == other._said and all(np.array_equal(a, b) for a, b in arrays)

    def __hash__(self) -> int:
        return hash((*self._said[:3], self.values.tobytes()))

    @property
    def _said(self) -> tuple[object, ...]:
        return (self.against, self.frame, self.acts_on, self.formula, dict(self.parameters),
                len(self.axes))

    @property
    def needs_position(self) -> bool:
        """Whether it has to know where the particles are, or which they are."""
        return self.against in ('position', 'neighbour distance', 'heading', 'particle')

    @property
    def time_invariant(self) -> bool:
        """Whether it is the same at all times while the command stays."""
        return self.against not in ('time', 'time since switch')

    # What it does -------------------------------------------------------------------------------

    def heading_offset(self, context: EffectContext) -> np.ndarray | float:
        """The angle (..., 1 or N) [rad] that it adds to the heading."""
        return self._of(context)[..., 0] if self.acts_on == 'heading' else 0.0

    def speed_factor(self, context: EffectContext) -> np.ndarray | float:
        """What it multiplies the self-propulsion by (..., 1 or N), never less than zero."""
        if self.acts_on != 'speed':
            return 1.0
        return np.maximum(1 + self._of(context)[..., 0], 0.0)

    def drift(self, context: EffectContext) -> np.ndarray | None:
        """The velocity (..., 1 or N, 2) [m/s] that it adds; None where it acts otherwise."""
        return self._of(context) if self.acts_on == 'velocity' else None

    def inside(self, context: EffectContext) -> np.ndarray:
        """Whether each particle (..., 1 or N) is where data were, when it was learned."""
        where, weight = self._corners(self._pairs(context)[0] if self.frame == 'radial'
                                      else coordinate(self.against, context))
        known: np.ndarray = ((self.seen[where] & (weight > 0)) | (weight == 0)).all(axis=-1) & (
            weight.sum(axis=-1) > 0)
        # A neighbour that is far does nothing; one nearer than any was is no known case.
        return known if self.frame != 'radial' else ~(
            (self._pairs(context)[0] < self.axes[0][np.argmax(self.seen)]).any(axis=-1))

    def _of(self, context: EffectContext) -> np.ndarray:
        """Values (..., 1 or N, C) under a `context`, summed over neighbours."""
        if self.frame != 'radial':
            where, weight = self._corners(coordinate(self.against, context))
            return np.einsum('...k,...kc->...c', weight, self.values[where])
        distance, direction = self._pairs(context)
        where, weight = self._corners(distance)
        felt = np.einsum('...k,...kc->...c', weight, self.values[where])
        if self.acts_on == 'speed':
            return np.asarray(felt.sum(axis=-2))
        moved = (felt @ np.array([1, 1j]) * direction).sum(axis=-1)
        return np.stack([moved.real, moved.imag], axis=-1)

    # Where the covariate is among the knots -----------------------------------------------------

    def knots(self, context: EffectContext) -> tuple[np.ndarray, np.ndarray]:
        """The knots (..., 1 or N, k) that are felt, as rows of `values`, and what each weighs.

        In the frame `radial` every neighbour feels its own, and of a velocity they weigh complex,
        with the direction away from it. Where a knot comes more than once its weights add up.
        """
        if self.frame != 'radial':
            return self._corners(coordinate(self.against, context))
        distance, direction = self._pairs(context)
        where, weight = self._corners(distance)
        if self.acts_on == 'velocity':
            weight = weight * direction[..., None]
        flat = *where.shape[:-2], -1
        return where.reshape(flat), weight.reshape(flat)

    def _corners(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which knots (..., 2 or 4) are about the covariate `x`, and their weights, 0 beyond."""
        if self.against == 'particle':
            where = np.minimum(self.axes[0].searchsorted(x), len(self.axes[0]) - 1)
            return where[..., None], (self.axes[0][where] == x)[..., None].astype(float)
        if len(self.axes) == 1:
            return self._between(self.axes[0], x)
        (i, u), (j, v) = (self._between(axis, part)
                          for axis, part in zip(self.axes, (x.real, x.imag), strict=True))
        rows = len(self.axes[1])
        where = i[..., :, None] * rows + j[..., None, :]
        weight = u[..., :, None] * v[..., None, :]
        return where.reshape(*x.shape, 4), weight.reshape(*x.shape, 4)

    def _between(self, axis: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.against in PERIODIC:
            step = 2 * np.pi / len(axis)
            place = np.nan_to_num((x - axis[0]) / step) % len(axis)
            low = np.minimum(place.astype(int), len(axis) - 1)
            part = place - low
            weight = np.stack([1 - part, part], axis=-1) * np.isfinite(x)[..., None]
            return np.stack([low, (low + 1) % len(axis)], axis=-1), weight
        with np.errstate(invalid='ignore'):
            known = (x >= axis[0]) & (x <= axis[-1])
        low = np.clip(axis.searchsorted(np.where(known, x, axis[0]), side='right') - 1,
                      0, len(axis) - 2)
        part = (np.where(known, x, axis[0]) - axis[low]) / (axis[low + 1] - axis[low])
        return np.stack([low, low + 1], axis=-1), np.stack(
            [1 - part, part], axis=-1) * known[..., None]

    def _pairs(self, context: EffectContext) -> tuple[np.ndarray, np.ndarray]:
        """Distance (..., N, N) [m] of every pair and the direction from j (last) to i.

        Infinite, and 0, where there is no pair.
        """
        apart = context.known_places.separation
        distance = np.abs(apart)
        distance[~np.isfinite(distance) | (distance == 0)] = np.inf
        return distance, np.where(np.isfinite(distance), apart, 0.0) / np.where(
            np.isfinite(distance), distance, 1.0)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What its columns of `values` are called in files."""
        return VALUES[self.frame, self.acts_on]


def coordinate(against: Against, context: EffectContext) -> np.ndarray:
    """The covariate `against` which a term is drawn (..., 1 or N) [SI] under a `context`.

    A position is complex; an angle that is not defined, without a field, is NaN. ValueError where
    the context does not tell it. Distances of neighbours are of pairs: not here.
    """
    if against == 'position':
        return np.asarray(context.position @ np.array([1, 1j]))
    if against == 'time':
        return context.t
    if against == 'time since switch':
        return context.since_switch
    if against == 'field strength':
        return np.where(context.strength > 0, context.strength, np.nan)
    if against == 'frequency':
        return np.abs(context.frequency)
    if against == 'particle':
        return np.broadcast_to(context.known_places.ids, context.position.shape[:-1])
    angle = np.arctan2(context.field[..., 1], context.field[..., 0])
    if against == 'heading':
        angle = angle + context.known_places.phi
    return np.where(context.strength > 0, angle, np.nan)
