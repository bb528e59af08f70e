"""A small grammar of formulas that a table may follow, fitted through the moments.

Formulas are linear in their coefficients, which follow in closed form. Their shapes (times,
places, frequencies) are searched. The fit is measured on the raw increments, by G and b.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import product

import numpy as np

from microbot_ros.common.units import from_si, suffix
from microbot_ros.model.learned_term import AXES, PERIODIC, LearnedTerm

TRIED = 3
"""Number of starting shapes that are refined. Choice: the grids of starts are dense."""

Shape = tuple[float, ...]
"""Shape parameters of a formula, SI."""


@dataclass(frozen=True)
class Formula:
    """One formula of the grammar.

    Attributes
    ----------
    text : str
        The formula, for people.
    basis : callable
        Returns the columns (K·C, m) at the knots for a shape.
    coefficients : tuple of str
        Names of the coefficients (m,), with unit.
    names : tuple of str
        Names of the shape parameters, with unit.
    starts : tuple of Shape
        Grid of starting shapes.
    low, high : Shape
        Bounds of the shape.
    """

    text: str
    basis: Callable[[Shape], np.ndarray]
    coefficients: tuple[str, ...]
    names: tuple[str, ...] = ()
    starts: tuple[Shape, ...] = ((),)
    low: Shape = ()
    high: Shape = ()


@dataclass(frozen=True)
class FittedFormula:
    """A formula at its maximum.

    Attributes
    ----------
    formula : Formula
        The formula.
    shape : Shape
        Best shape, SI.
    weights : ndarray, shape (m,)
        Best coefficients, SI.
    gain : float
        Gain in log likelihood.
    rank : int
        Number of coefficients that the data determine.
    price : float
        Cost of each number, in log likelihood.
    """

    formula: Formula
    shape: Shape
    weights: np.ndarray
    gain: float
    rank: int
    price: float = 0.0

    @property
    def values(self) -> np.ndarray:
        """Values at the knots (K·C,)."""
        found: np.ndarray = self.formula.basis(self.shape) @ self.weights
        return found

    @property
    def size(self) -> int:
        """Number of fitted parameters."""
        return self.rank + len(self.shape)

    @property
    def paid(self) -> float:
        """Gain less the cost of its parameters."""
        return self.gain - self.price * self.size

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters by name, in the unit of the name."""
        shape = {name: float(from_si(name, x))
                 for name, x in zip(self.formula.names, self.shape, strict=True)}
        rest = {name: float(from_si(name, float(w)))
                for name, w in zip(self.formula.coefficients, self.weights, strict=True)}
        return shape | rest


def fit(formula: Formula, gram: np.ndarray, projection: np.ndarray,
        begin: Shape | None = None) -> FittedFormula:
    """Fit a formula to the moments of a table.

    Parameters
    ----------
    formula : Formula
        The formula.
    gram : ndarray, shape (K, K)
        Information G on the values at the knots.
    projection : ndarray, shape (K,)
        Projection b of the data on the knots.
    begin : Shape, optional
        Starting shape; by default the best of the formula's starts.

    Returns
    -------
    FittedFormula
        The maximum of the likelihood.
    """
    from scipy.optimize import minimize

    def at(shape: Sequence[float]) -> FittedFormula:
        return _solve(formula, tuple(float(s) for s in shape), gram, projection)

    if not formula.names:
        return at(())
    low, high = np.array(formula.low), np.array(formula.high)
    starts = [begin] if begin is not None else sorted(
        formula.starts, key=lambda shape: -at(shape).gain)[:TRIED]
    best = max((at(shape) for shape in starts), key=lambda one: one.gain)
    for start in starts:
        # A simplex also crosses steps, where the gradient is zero.
        first = np.clip(start, low, high)
        simplex = np.vstack([first, *(
            np.where(np.arange(len(first)) == k, np.where(
                first + 0.1 * (high - low) <= high, first + 0.1 * (high - low),
                first - 0.1 * (high - low)), first) for k in range(len(first)))])
        found = minimize(
            lambda shape: -at(shape).gain, first, method='Nelder-Mead',
            bounds=list(zip(low, high, strict=True)),
            options={'initial_simplex': simplex, 'maxfev': 60 * len(first), 'fatol': 0.02,
                     'xatol': 1e-3 * float((high - low).min())})
        one = at(np.clip(found.x, low, high))
        best = one if one.gain > best.gain else best
    return best


def _solve(formula: Formula, shape: Shape, gram: np.ndarray,
           projection: np.ndarray) -> FittedFormula:
    columns = formula.basis(shape)
    size = np.sqrt(np.maximum(np.einsum('km,km->m', columns, gram @ columns), 1e-300))
    inside = (columns / size).T @ gram @ (columns / size)
    right = (columns / size).T @ projection
    values, vectors = np.linalg.eigh(inside)
    kept = values > 1e-5
    along = (vectors[:, kept].T @ right) / values[kept]
    gain = 0.5 * float((vectors[:, kept].T @ right) @ along)
    # A column that v and φ absorb has no size of its own.
    rank = int(kept.sum())
    return FittedFormula(formula, shape, (vectors[:, kept] @ along) / size, gain, rank)


# The grammar ------------------------------------------------------------------------------------

def grammar(term: LearnedTerm) -> list[Formula]:
    """Return all formulas for the covariate of a term.

    Parameters
    ----------
    term : LearnedTerm
        The table.

    Returns
    -------
    list of Formula
        Empty for a value per particle.
    """
    near = _near(term)
    if term.against == 'particle':
        return []
    if term.against == 'position':
        return list(_of_place(_Table(term, near)))
    if term.against in PERIODIC:
        return list(_of_angle(_Table(term, near)))
    return list(_of_line(_Table(term, near)))


def _near(term: LearnedTerm) -> np.ndarray:
    """Return at which knots (K,) formulas act.

    These are the ones with data and next to one with data; of one axis that is no angle, also
    those between.
    """
    if len(term.axes) == 1:
        seen = term.seen
        if term.against in PERIODIC:
            return np.asarray(seen | np.roll(seen, 1) | np.roll(seen, -1))
        first, last = np.flatnonzero(seen)[[0, -1]]
        inside = np.zeros(len(seen), bool)
        inside[max(first - 1, 1):min(last + 2, len(seen) - 1)] = True
        return inside
    seen = term.seen.reshape([len(axis) for axis in term.axes])
    grown = seen.copy()
    for shift, axis in product((1, -1), (0, 1)):
        grown |= np.roll(seen, shift, axis)
    return np.asarray(grown.ravel())


@dataclass(frozen=True)
class _Table:
    """Knots of a `term`: the covariate `x`, `y` (K,) at each, and which are `near` data."""

    term: LearnedTerm
    near: np.ndarray
    x: np.ndarray = field(init=False)
    y: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        axes = np.meshgrid(*self.term.axes, indexing='ij')
        object.__setattr__(self, 'x', axes[0].ravel())
        object.__setattr__(self, 'y', axes[-1].ravel())

    @property
    def middle(self) -> tuple[float, float]:
        """Middle of the range of the data, on each axis."""
        return tuple(float(axis[self.term.seen].min() + axis[self.term.seen].max()) / 2
                     for axis in (self.x, self.y))  # type: ignore[return-value]

    @property
    def half(self) -> float:
        """Half of the larger range of the data."""
        return max(float(np.ptp(axis[self.term.seen])) / 2 for axis in (self.x, self.y)) or 1.0

    @cached_property
    def scaled(self) -> tuple[np.ndarray, np.ndarray]:
        """Both axes, from −1 to 1 over the larger range of the data."""
        (x0, y0), half = self.middle, self.half
        return (self.x - x0) / half, (self.y - y0) / half

    def along(self, angle: float) -> np.ndarray:
        """Return the scaled place (K,) along the direction `angle` [rad]."""
        u, v = self.scaled
        return np.asarray(u * np.cos(angle) + v * np.sin(angle))

    @property
    def unit(self) -> str:
        """Suffix of the covariate's unit."""
        return suffix(AXES[self.term.against][0])

    def each(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """Return factors (K,) as columns (K·C, m·C): each component has its own coefficients."""
        stacked = np.stack([np.broadcast_to(c, self.x.shape) for c in columns], axis=1)
        return np.kron(np.eye(self.term.values.shape[1]), stacked * self.near[:, None])

    def field(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """Return complex velocities (K,) as columns (2K, m)."""
        stacked = np.stack(columns, axis=1) * self.near[:, None]
        return np.concatenate([stacked.real, stacked.imag])

    def named(self, count: int, *, field: bool = False) -> tuple[str, ...]:
        """Return names for the coefficients of `count` columns."""
        ending = {'velocity': '_um_s', 'speed': '', 'heading': '_rad'}[self.term.acts_on]
        if field or self.term.values.shape[1] == 1:
            return tuple(f'c{k}{ending}' for k in range(count))
        return tuple(f'c{k}{axis}{ending}'
                     for axis in (name[:name.index('_')] if self.term.frame == 'radial'
                                  else name[0] for name in self.term.names)
                     for k in range(count))


def _fixed(columns: np.ndarray) -> Callable[[Shape], np.ndarray]:
    """Return a basis without a shape."""
    return lambda _: columns


def _of_line(t: _Table) -> Iterator[Formula]:
    """Yield formulas of a covariate on a line; `u` runs from −1 to 1 over the data."""
    (middle, _), half = t.middle, t.half
    u = (t.x - middle) / half
    low, span = middle - half, 2 * half
    unit = t.unit
    for degree, text in ((1, 'c0 + c1 u'), (2, 'c0 + c1 u + c2 u²'),
                         (3, 'c0 + c1 u + c2 u² + c3 u³')):
        powers = [u**k for k in range(degree + 1)]
        yield Formula(text, _fixed(t.each(powers)), t.named(degree + 1))
    falls = tuple((span * part,) for part in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6))
    yield Formula(
        'c0 + c1 exp(−(x − x₀)/a)', lambda s: t.each([1.0 + 0 * u, np.exp(-(t.x - low) / s[0])]),
        t.named(2), (f'a{unit}',), falls, (0.02 * span,), (3 * span,))
    yield Formula(
        'c0 exp(−(x − x₀)/a)', lambda s: t.each([np.exp(-(t.x - low) / s[0])]),
        t.named(1), (f'a{unit}',), falls, (0.02 * span,), (3 * span,))
    inside = tuple((low + span * part,) for part in np.linspace(0.06, 0.94, 23))
    yield Formula(
        'c0 + c1 H(x − a)', lambda s: t.each([1.0 + 0 * u, np.clip(
            (t.x - s[0]) / _spacing(t) + 0.5, 0, 1)]), t.named(2), (f'a{unit}',),
        tuple((float(x),) for x in t.x[2:-2]), (low,), (low + span,))
    for n in (1, 2, 4):
        yield Formula(
            f'c0 + c1 {_power("x", n)}/({_power("x", n)} + {_power("a", n)})',
            partial(_risen, t, n),
            t.named(2), (f'a{unit}',), inside, (max(low, 1e-3 * span),), (low + 2 * span,))
    if t.term.against == 'time':
        yield Formula(
            'c0 cos 2πat + c1 sin 2πat', lambda s: t.each([
                np.cos(2 * np.pi * s[0] * t.x), np.sin(2 * np.pi * s[0] * t.x)]),
            t.named(2), ('a_hz',), tuple((k / span,) for k in np.arange(1, len(t.x) / 3, 0.25)),
            (0.5 / span,), (len(t.x) / 2.5 / span,))
    if low > 0:
        for n in (1, 2, 3, 4):
            yield Formula(
                f'c0 x{str(-n).translate(_RAISED)}',
                _fixed(t.each([(low / np.maximum(t.x, low / 2)) ** n])), t.named(1))


_RAISED = str.maketrans('-1234', '⁻¹²³⁴')
"""Superscripts of exponents."""


def _power(name: str, n: int) -> str:
    return name if n == 1 else name + str(n).translate(_RAISED)


def _spacing(t: _Table) -> float:
    return float(np.median(np.diff(t.term.axes[0])))


def _risen(t: _Table, n: int, shape: Shape) -> np.ndarray:
    """Return columns of a constant and a Hill curve of exponent `n`."""
    risen = np.maximum(t.x, 0.0) ** n
    return t.each([1.0 + 0 * t.x, risen / (risen + shape[0] ** n)])


def _apart(t: _Table, shape: Shape) -> np.ndarray:
    """Return the complex distance from a place (shape[0], shape[1]) to every knot."""
    return np.asarray((t.x - shape[0]) + 1j * (t.y - shape[1]))


def _about(t: _Table, turn: complex, fall: Callable[[np.ndarray, float], np.ndarray],
           shape: Shape) -> np.ndarray:
    """Return columns of a velocity away from a place (`turn` 1) or around it (`turn` i)."""
    w = _apart(t, shape)
    return t.field([turn * w * fall(np.abs(w), shape[2])])


def _of_angle(t: _Table) -> Iterator[Formula]:
    one = 1.0 + 0 * t.x
    for n in (1, 2, 3, 4):
        times = '' if n == 1 else str(n)
        yield Formula(
            f'c0 + c1 cos {times}θ + c2 sin {times}θ',
            _fixed(t.each([one, np.cos(n * t.x), np.sin(n * t.x)])), t.named(3))


_ANGLES = tuple(np.arange(12) * np.pi / 6)
"""Directions from which a fit starts."""


def _of_place(t: _Table) -> Iterator[Formula]:
    """Yield formulas of place; `u` and `v` run from −1 to 1 over the larger range of the data."""
    u, v = t.scaled
    one = 1.0 + 0 * u
    yield Formula('c0 + c1 u + c2 v', _fixed(t.each([one, u, v])), t.named(3))
    yield Formula('c0 + c1 u + c2 v + c3 u² + c4 uv + c5 v²',
                  _fixed(t.each([one, u, v, u * u, u * v, v * v])), t.named(6))
    yield from (_flows if t.term.acts_on == 'velocity' else _factors)(t)


def _spot(t: _Table) -> tuple[tuple[str, ...], tuple[Shape, ...], Shape, Shape]:
    """Return names, starting points and bounds of a place and a radius."""
    (x0, y0), half = t.middle, t.half
    places = tuple(np.linspace(-0.9, 0.9, 5))
    starts = tuple((half * x + x0, half * y + y0, half * a)
                   for x, y, a in product(places, places, (0.2, 0.5)))
    return (('x_um', 'y_um', 'a_um'), starts, (x0 - 1.3 * half, y0 - 1.3 * half, 0.08 * half),
            (x0 + 1.3 * half, y0 + 1.3 * half, 2.0 * half))


def _flows(t: _Table) -> Iterator[Formula]:
    """Yield velocities in one direction, with any profile across it, and about a place."""
    names, starts, lows, highs = spot = _spot(t)

    def profile(s: Shape, factors: Callable[[np.ndarray], list[np.ndarray]]) -> np.ndarray:
        way = -1j * np.exp(1j * s[0])
        return t.field([way * f for f in factors(t.along(s[0]))])

    yield Formula('(c0 + c1 s + c2 s²) along, s across',
                  lambda s: profile(s, lambda q: [1 + 0 * q, q, q * q]),
                  t.named(3, field=True), ('angle_rad',), tuple((a,) for a in _ANGLES[:6]),
                  (-np.pi,), (np.pi,))
    yield Formula(
        '(c0 cos ks + c1 sin ks) along, s across',
        lambda s: profile(s, lambda q: [np.cos(s[1] * q), np.sin(s[1] * q)]),
        t.named(2, field=True), ('angle_rad', 'k'),
        tuple(product(_ANGLES[:6], (3.0, 4.5, 6.0))), (-np.pi, 3.0), (np.pi, 9.0))
    yield Formula(
        'c0 exp(−s/a) along',
        lambda s: t.field([np.exp(1j * s[0] - (t.along(s[0]) + 1) / s[1])]),
        t.named(1, field=True), ('angle_rad', 'a'), tuple(product(_ANGLES, (0.2, 0.6))),
        (-2 * np.pi, 0.05), (2 * np.pi, 2.0))
    for text, turn, fall in (
            ('c0 (−y, x)/(r² + a²)', 1j, lambda r, a: a / (r**2 + a**2)),
            ('c0 (x, y)/(r² + a²)', 1.0, lambda r, a: a / (r**2 + a**2)),
            ('c0 (−y, x) exp(−r²/2a²)', 1j, lambda r, a: np.exp(-(r**2) / (2 * a**2)) / a),
            ('c0 (x, y) exp(−r²/2a²)', 1.0, lambda r, a: np.exp(-(r**2) / (2 * a**2)) / a),
            ('c0 (x, y)/(r + a)', 1.0, lambda r, a: 1 / (r + a))):
        yield Formula(text, partial(_about, t, turn, fall), t.named(1, field=True), *spot)
    yield Formula('c0 (x, y) about a place', lambda s: t.field([_apart(t, (*s, 0.0)) / t.half]),
                  t.named(1, field=True), names[:2],
                  tuple((x, y) for x, y, _ in starts[::2]), lows[:2], highs[:2])


def _factors(t: _Table) -> Iterator[Formula]:
    """Yield factors of the speed, or angles, that depend on place."""
    u, v = t.scaled
    one, spot = 1.0 + 0 * u, _spot(t)
    yield Formula(
        'c0 + c1 exp(−s/a)', lambda s: t.each([one, np.exp(-(t.along(s[0]) + 1) / s[1])]),
        t.named(2), ('angle_rad', 'a'), tuple(product(_ANGLES, (0.3, 1.0))),
        (-2 * np.pi, 0.05), (2 * np.pi, 3.0))
    yield Formula(
        'c0 + c1 cos(k·p) + c2 sin(k·p)', lambda s: t.each([
            one, np.cos(s[0] * u + s[1] * v), np.sin(s[0] * u + s[1] * v)]),
        t.named(3), ('kx', 'ky'),
        tuple(product((0.0, 2.0, 4.0, 6.0), (-5.0, -2.5, 0.0, 2.5, 5.0))),
        (-1.0, -9.0), (9.0, 9.0))
    yield Formula(
        'c0 + c1 H(s − a)', lambda s: t.each([one, np.clip(
            (t.along(s[0]) - s[1]) * t.half / _spacing(t) + 0.5, 0, 1)]), t.named(2),
        ('angle_rad', 'a'), tuple(product(_ANGLES[:6], (-0.5, -0.2, 0.0, 0.2, 0.5))),
        (-np.pi, -1.0), (np.pi, 1.0))
    yield Formula('c0 + c1 exp(−r²/2a²)', lambda s: t.each(
        [one, np.exp(-np.abs(_apart(t, s)) ** 2 / (2 * s[2] ** 2))]), t.named(2), *spot)
    yield Formula('c0 + c1/(r² + a²)', lambda s: t.each(
        [one, s[2] ** 2 / (np.abs(_apart(t, s)) ** 2 + s[2] ** 2)]), t.named(2), *spot)
