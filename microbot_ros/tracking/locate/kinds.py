"""Kinds of bodies taught by examples and counter-examples.

A kind is a range for each of six traits, so that it can be read, stored, shared and edited. A
range contains the examples and a margin; each further example narrows the margin. A
counter-example cuts the range in which it is farthest from the examples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from microbot_ros.common.checked import Field, Settings, SettingsError
from microbot_ros.common.errors import InputError
from microbot_ros.tracking.locate.bodies import Bodies

TRAITS = ('height_grey', 'width_px', 'edge_px', 'elongation', 'fill', 'halo')
"""Names of the traits, in order; see `Bodies`."""

# Choices, per trait: where ratios count, and how far a range extends beyond one example.
_LOGARITHMIC = np.array([True, True, True, True, False, False])

_BELOW = np.array([math.log(1 / 0.45), math.log(2.6), math.log(3.0), math.inf, 0.25, math.inf])
"""Choice, per trait: how far a range extends below one example; in logarithms where
`_LOGARITHMIC`."""
_ABOVE = np.array([math.log(2.2), math.log(3.0), math.log(1.65), math.log(2.2), math.inf, 0.09])
"""Choice, per trait: how far a range extends above one example; in logarithms where
`_LOGARITHMIC`."""

_LENIENT = np.array([math.log(1.7), math.log(1.3), math.log(1.5), math.log(1.5), 0.15, math.inf])
"""Choice: extra margin for a body where one of its kind is expected."""

_ODDEST = 1.15
"""Choice: largest oddity of a body in all traits together."""

_APART = np.array([0.05, 0.08, 0.05, 0.08, 0.03, 0.02])
"""Choice: least difference by which a trait separates two bodies."""

Traits = tuple[float, float, float, float, float, float]
Range = tuple[float, float]


class Kind(Settings):
    """One kind of body: ranges of its traits, and the examples they come from."""

    name: str = Field(default='robot', pattern=r'^[A-Za-z][\w-]{0,31}\Z',
                      description='name in the column `kind`')
    contrast: Literal['dark', 'bright'] = Field(
        default='dark', description='whether it is darker or brighter than the light around it')
    parts_px: float = Field(
        default=0.0, ge=0, le=200, description='parts closer than this are one body [px]')
    shrink: int = Field(
        default=1, ge=1, le=16, description='binning: pixels averaged along each axis')
    height_grey: Range = Field(default=(8.0, 1e6), description='its contrast [grey levels]')
    width_px: Range = Field(
        default=(3.0, 60.0), description='diameter of a disc of equal area [px]')
    edge_px: Range = Field(
        default=(0.0, 1e6), description='width of its edge, small in focus [px]')
    elongation: Range = Field(default=(1.0, 1e6), description='length over width')
    fill: Range = Field(default=(0.0, 2.0), description='area over that of the ellipse around it')
    halo: Range = Field(
        default=(-1.0, 1e6),
        description='contrast of the opposite sign beside it, relative to its '
                                 'contrast')
    like: tuple[Traits, ...] = Field(
        default=(), description='traits of the examples, in the order above')
    unlike: tuple[Traits, ...] = Field(default=(), description='traits of the counter-examples')

    def __post_init__(self) -> None:
        for trait in TRAITS:
            low, high = getattr(self, trait)
            if not low <= high:
                raise SettingsError(f'expected the lower end first; received {low:g}, {high:g}',
                                    trait)
        if not self.width_px[0] > 0:
            raise SettingsError(f'expected widths above 0; received {self.width_px[0]:g}',
                                'width_px')

    @property
    def dark(self) -> bool:
        """Whether it is darker than the illumination."""
        return self.contrast == 'dark'

    @property
    def ranges(self) -> np.ndarray:
        """Lower and upper ends (6, 2) of the traits, as `scaled`."""
        ends = np.array([getattr(self, name) for name in TRAITS], float)
        return scaled(ends.T).T

    @property
    def typical(self) -> np.ndarray:
        """Typical traits (6,), as `scaled`: the middle of the examples, or of the ranges."""
        if self.like:
            return np.asarray(np.median(scaled(np.array(self.like)), axis=0))
        ends = self.ranges
        return np.asarray(np.where(np.abs(ends[:, 1]) < 10, ends.mean(axis=1), ends[:, 0]))

    @property
    def typical_width_px(self) -> float:
        """Usual width [px]."""
        return float(np.exp(self.typical[1]))

    def members(self, bodies: Bodies, lenient: np.ndarray) -> np.ndarray:
        """Return which `bodies` (N,) are of this kind; `lenient` (N,) where one is expected.

        A body cut by the edge of the picture does not show its shape: it counts only where
        expected.

        Parameters
        ----------
        bodies : Bodies
            The N bodies.
        lenient : ndarray, shape (N,)
            Whether one is expected there.

        Returns
        -------
        ndarray, shape (N,)
            Whether each body is of the kind.
        """
        values, ends = scaled(traits(bodies)), self.ranges
        slack = np.where(lenient[:, None], _LENIENT, 0.0)
        inside = (values >= ends[:, 0] - slack) & (values <= ends[:, 1] + slack)
        alike = ~bodies.cut & (self._oddity(values) <= _ODDEST)
        return np.asarray(inside.all(axis=1) & (lenient | alike))

    def _oddity(self, values: np.ndarray) -> np.ndarray:
        """Return how odd bodies with `values` (N, 6), as `scaled`, are in all traits together.

        The root of the sum of squared distances beyond the examples, each 1 at the end of its
        range: a body both smaller and paler by the whole margin is something else. Open ranges do
        not count.
        """
        if not self.like:
            return np.zeros(len(values))
        examples, ends = scaled(np.array(self.like)), self.ranges
        low, high = examples.min(axis=0), examples.max(axis=0)
        below = np.maximum(low - values, 0) / np.maximum(low - ends[:, 0], 1e-9)
        above = np.maximum(values - high, 0) / np.maximum(ends[:, 1] - high, 1e-9)
        beyond = np.where(np.isfinite(_BELOW), below, 0) + np.where(np.isfinite(_ABOVE), above, 0)
        return np.asarray(np.sqrt(np.sum(beyond**2, axis=1)))

    def strangeness(self, bodies: Bodies) -> np.ndarray:
        """Return the distance (N,) of `bodies` from typical, in units of one example's margins.

        Parameters
        ----------
        bodies : Bodies
            The N bodies.

        Returns
        -------
        ndarray, shape (N,)
            Distances.
        """
        reach = np.where(np.isfinite(_ABOVE), _ABOVE, _BELOW)
        off = (scaled(traits(bodies)) - self.typical) / reach
        return np.asarray(np.sqrt(np.mean(off**2, axis=1)))


def traits(bodies: Bodies) -> np.ndarray:
    """Return the traits (N, 6) of `bodies`, in order of `TRAITS`.

    Parameters
    ----------
    bodies : Bodies
        The N bodies.

    Returns
    -------
    ndarray, shape (N, 6)
        Traits.
    """
    return np.column_stack([
        bodies.height, bodies.width, bodies.edge, bodies.length, bodies.fill, bodies.halo])


def scaled(values: np.ndarray) -> np.ndarray:
    """Return `values` (N, 6) of traits with the logarithm where ratios count.

    Parameters
    ----------
    values : ndarray, shape (N, 6)
        Traits.

    Returns
    -------
    ndarray, shape (N, 6)
        Scaled traits.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where(_LOGARITHMIC, np.log(np.maximum(values, 1e-9)), values)


def with_examples(
    kind: Kind, like: Sequence[Traits], unlike: Sequence[Traits], clutter: float
) -> Kind:
    """Return the `kind` with ranges learned from examples `like` and counter-examples `unlike` it.

    `clutter` [grey] is the usual contrast of opposite sign in the picture, which may lie beside
    any body. Raises InputError if a counter-example cannot be told from the examples.

    Parameters
    ----------
    kind : Kind
        The kind.
    like : sequence of Traits
        Examples.
    unlike : sequence of Traits
        Counter-examples.
    clutter : float
        Usual contrast of opposite sign [grey].

    Returns
    -------
    Kind
        The kind.
    """
    examples = scaled(np.array(like, float))
    open_still = 0.5 + 0.5 / len(like)
    above = _ABOVE.copy()
    above[-1] += clutter / float(np.min(np.array(like)[:, 0]))
    ends = np.column_stack([
        examples.min(axis=0) - open_still * _BELOW, examples.max(axis=0) + open_still * above])
    for other in scaled(np.array(unlike, float).reshape(-1, len(TRAITS))):
        _cut(ends, examples, other, kind.name)
    # Rounded to few digits, since people read and edit them.
    natural = np.where(_LOGARITHMIC[:, None], np.exp(np.minimum(ends, 13.8)), np.clip(ends, -1, 9))
    natural[:, 0] = np.where(np.isfinite(ends[:, 0]), natural[:, 0], [0, 0, 0, 1, 0, -1])
    fields = {name: tuple(float(f'{end:.4g}') for end in natural[k])
              for k, name in enumerate(TRAITS)}
    return Kind.from_content(kind.content() | fields | {
        'like': _rounded(like), 'unlike': _rounded(unlike)})


def _rounded(examples: Sequence[Traits]) -> list[tuple[float, ...]]:
    return [tuple(float(f'{value:.4g}') for value in example) for example in examples]


def _cut(ends: np.ndarray, examples: np.ndarray, other: np.ndarray, name: str) -> None:
    """Narrow the range in which a counter-example is farthest from all examples, in place."""
    if np.any((other < ends[:, 0]) | (other > ends[:, 1])):
        return
    below, above = examples.min(axis=0) - other, other - examples.max(axis=0)
    far = np.maximum(below, above) / _APART
    k = int(np.argmax(far))
    if far[k] < 1:
        raise InputError('unlike', f'expected something unlike the examples of {name}: by '
                                   'size, contrast, sharpness and shape this is one of them')
    if below[k] > above[k]:
        ends[k, 0] = other[k] + below[k] / 2
    else:
        ends[k, 1] = other[k] - above[k] / 2
