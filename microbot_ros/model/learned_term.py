"""Learned term: a table over one covariate, where no known effect explains the data.

It changes velocity, speed or heading as an effect does, and consists of numbers only: values at
knots of the covariate, linear between them. Beyond the region of the data it fades to zero.
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
"""Covariate of a term."""

Frame = Literal['laboratory', 'heading', 'radial']
"""Frame of its values."""

ActsOn = Literal['velocity', 'speed', 'heading']
"""Quantity that it changes."""

COVARIATES: tuple[str, ...] = get_args(Against)
"""All covariates."""

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
"""Names, with unit, of the knots of each covariate in files."""

VALUES: dict[tuple[str, str], tuple[str, ...]] = {
    ('laboratory', 'velocity'): ('x_um_s', 'y_um_s'),
    ('radial', 'velocity'): ('away_um_s', 'around_um_s'),
    ('heading', 'speed'): ('factor',),
    ('radial', 'speed'): ('factor',),
    ('heading', 'heading'): ('turn_rad',),
}
"""Names, with unit, of the values in files, for each allowed frame and acted-on quantity."""

PERIODIC = ('command angle', 'heading')
"""Covariates of period 2π; their knots divide the turn equally."""


@dataclass(frozen=True)
class LearnedTerm:
    """Table of K knots and C components of what is missing in the model.

    Attributes
    ----------
    against : Against
        The covariate.
    frame : Frame
        Frame of the values.
    acts_on : ActsOn
        Quantity that it changes.
    axes : tuple of ndarray, shape (K,)
        Knots of the covariate, ascending, SI. For positions those of x and of y, which make a
        grid.
    values : ndarray, shape (K, C)
        Values at the knots, for a grid x by x. Of a velocity x and y [m/s]; in the frame `radial`
        away from a neighbour and anticlockwise around it, summed over neighbours. Of a speed what
        is added to the factor 1, by each neighbour in the frame `radial`. Of a heading the added
        angle [rad].
    low, high : ndarray, shape (K, C)
        95 % band.
    seen : ndarray of bool, shape (K,)
        Whether the knot had data; values fade to zero beyond.
    formula : str or None
        Formula that explains as much, for people: the table is what acts.
    parameters : mapping of str to float
        Parameters of the formula.
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
        """Whether it depends on the places or the identities of particles."""
        return self.against in ('position', 'neighbour distance', 'heading', 'particle')

    @property
    def time_invariant(self) -> bool:
        """Whether it is constant in time under a constant command."""
        return self.against not in ('time', 'time since switch')

    # Its action ---------------------------------------------------------------------------------

    def heading_offset(self, context: EffectContext) -> np.ndarray | float:
        """Return the angle that it adds to the heading.

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N), or float
            Angle [rad].
        """
        return self._of(context)[..., 0] if self.acts_on == 'heading' else 0.0

    def speed_factor(self, context: EffectContext) -> np.ndarray | float:
        """Return its factor on the self-propulsion.

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N), or float
            Factor, never negative.
        """
        if self.acts_on != 'speed':
            return 1.0
        return np.maximum(1 + self._of(context)[..., 0], 0.0)

    def drift(self, context: EffectContext) -> np.ndarray | None:
        """Return the velocity that it adds.

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N, 2), or None
            Velocity [m/s]; None if it acts on speed or heading.
        """
        return self._of(context) if self.acts_on == 'velocity' else None

    def inside(self, context: EffectContext) -> np.ndarray:
        """Return whether each particle is where the term had data.

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray of bool, shape (..., 1 or N)
            In the frame `radial`, whether no neighbour is closer than any in the data.
        """
        where, weight = self._corners(self._pairs(context)[0] if self.frame == 'radial'
                                      else coordinate(self.against, context))
        known: np.ndarray = ((self.seen[where] & (weight > 0)) | (weight == 0)).all(axis=-1) & (
            weight.sum(axis=-1) > 0)
        # A neighbour that is far does nothing; one nearer than any was is no known case.
        return known if self.frame != 'radial' else ~(
            (self._pairs(context)[0] < self.axes[0][np.argmax(self.seen)]).any(axis=-1))

    def _of(self, context: EffectContext) -> np.ndarray:
        """Return values (..., 1 or N, C) under a `context`, summed over neighbours."""
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
        """Return the knots that act, and their weights.

        In the frame `radial` each neighbour has its own knots. Weights of a velocity are complex
        there, with the direction away from the neighbour. The weights of a knot that occurs more
        than once add up.

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        where : ndarray of int, shape (..., 1 or N, k)
            Rows of `values`.
        weight : ndarray, shape (..., 1 or N, k)
            Weights.
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
        """Return the knots (..., 2 or 4) around the covariate `x`, and their weights, 0 beyond."""
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
        """Return distance (..., N, N) [m] of each pair and direction from j (last axis) to i.

        Infinite, and 0, where there is no pair.
        """
        apart = context.known_places.separation
        distance = np.abs(apart)
        distance[~np.isfinite(distance) | (distance == 0)] = np.inf
        return distance, np.where(np.isfinite(distance), apart, 0.0) / np.where(
            np.isfinite(distance), distance, 1.0)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns of `values` in files."""
        return VALUES[self.frame, self.acts_on]


def coordinate(against: Against, context: EffectContext) -> np.ndarray:
    """Return the value of a covariate.

    Parameters
    ----------
    against : Against
        The covariate, except the distance of neighbours, which belongs to pairs.
    context : EffectContext
        Times, fields and places.

    Returns
    -------
    ndarray, shape (..., 1 or N)
        SI. A position is complex; an angle without a field is NaN.

    Raises
    ------
    ValueError
        If the context does not have it.
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
