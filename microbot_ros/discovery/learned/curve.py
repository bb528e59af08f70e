"""Curves as Gaussian processes of reduced rank, inside the whitened likelihood.

The prior on the values at the knots, w ~ N(0, a·C), is truncated to the leading eigenvectors of C
(a Karhunen–Loève expansion; Solin and Särkkä 2020 show that this loses nothing). Marginal
likelihood and posterior then follow from G and b (`moments`) in closed form (Rasmussen and
Williams 2006, ch. 2 and 5). Length scales, strengths and kinds of kernel are averaged over, not
selected.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from microbot_ros.discovery.learned.moments import Moments
from microbot_ros.model.learned_term import PERIODIC, Against, LearnedTerm

KEPT = 1e-4
"""Relative eigenvalue of a kernel below which eigenvectors are dropped.

Choice: they carry 1 % of an amplitude at most; a smaller value costs time.
"""

STRENGTHS = 10.0 ** np.arange(0.0, 5.1, 0.5)
"""Expected evidence λ of the priors that are averaged over.

Choice: from not detectable to far above; half a decade apart the evidence varies little.
"""

LENGTHS = (0.08, 0.16, 0.32, 0.64)
"""Length scales, as fractions of the covariate's range.

Choice: from a few knots to most of the range, each twice the one before.
"""

WAYS = np.arange(8) * np.pi / 8
"""Directions [rad] of flows along one line. Choice: 22.5° apart, cos 11° = 0.98 at worst."""

TURNS = (0.35, 0.7, 1.4)
"""Length scales ℓ of periodic kernels exp(−2 sin²(Δ/2)/ℓ²).

Choice: from a twentieth of a turn to the first harmonic, each twice the one before.
"""


@dataclass(frozen=True)
class Kernel:
    """One prior shape of a table.

    Attributes
    ----------
    kind : str
        Kind of kernel, for people.
    basis : ndarray, shape (K·C, R)
        Scaled eigenvectors of the prior covariance, as orthogonal columns.
    share : float
        Prior probability of the kernel.
    """

    kind: str
    basis: np.ndarray
    share: float


def kernels(term: LearnedTerm) -> list[Kernel]:
    """Return all kernels that are tried for a table.

    Lengths are fractions of the covariate's range, so tables of the same form have the same
    kernels.

    Parameters
    ----------
    term : LearnedTerm
        Table with K knots and C components.

    Returns
    -------
    list of Kernel
        Their `share` adds up to 1.
    """
    in_laboratory = term.frame == 'laboratory' and term.acts_on == 'velocity'
    axes = (_logarithmic(term.axes[0]),) if term.against == 'neighbour distance' else term.axes
    if term.against not in (*PERIODIC, 'particle'):
        size = max(np.ptp(axis[1:-1]) for axis in axes)
        axes = tuple(np.round((axis - axis[1]) / size, 9) for axis in axes)
    return _kernels_of(term.against, term.values.shape[1], in_laboratory,
                       tuple(tuple(axis.tolist()) for axis in axes))


def _logarithmic(distance: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(distance, distance[1]))


@lru_cache(64)
def _kernels_of(against: Against, components: int, in_laboratory: bool,
                axes: tuple[tuple[float, ...], ...]) -> list[Kernel]:
    """Return the kernels of a table against a covariate, with knots on `axes`."""
    found = list(_kernels(against, components, in_laboratory, tuple(map(np.array, axes))))
    total = sum(one.share for one in found)
    return [Kernel(one.kind, one.basis, one.share / total) for one in found]


def _kernels(against: Against, components: int, in_laboratory: bool,
             axes: tuple[np.ndarray, ...]) -> Iterator[Kernel]:
    free = _free(against, axes)
    if against == 'position':
        yield from _of_place(axes, free, components)
        return
    x = axes[0]
    apart = x[:, None] - x[None, :]
    if against == 'particle':
        yield Kernel('any', _spread(np.eye(len(x)), free, components), 1.0)
        return
    if against in PERIODIC:
        for length in TURNS:
            yield Kernel('smooth', _spread(
                np.exp(-2 * np.sin(apart / 2) ** 2 / length**2), free, components), 1.0)
        return
    for length in LENGTHS:
        smooth = np.exp(-0.5 * (apart / length) ** 2)
        yield Kernel('smooth', _spread(smooth, free, components), 1.0)
        if in_laboratory:
            line = _spread(smooth, free, 1)
            for way in WAYS:
                yield Kernel('along a line', _directed(way, line), 1.0 / len(WAYS))
        yield Kernel('rough', _spread(np.exp(-np.abs(apart) / (3 * length)), free, components),
                     0.5)
    if against == 'time':
        frequencies = np.arange(1.5, 0.4 * len(x), 0.5)
        for f in frequencies:
            yield Kernel('swing', np.kron(np.eye(components), _swing(f, x, free)),
                         6.0 / len(frequencies))


def _swing(frequency: float, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return what `_spread` makes of cos 2πf(x − x') for one component; its rank is two."""
    phase = 2 * np.pi * frequency * x
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1) * free[:, None]
    vectors, sizes, _ = np.linalg.svd(waves, full_matrices=False)
    kept = sizes**2 > KEPT * sizes[0] ** 2
    scaled: np.ndarray = vectors[:, kept] * sizes[kept]
    return scaled


def _parallel(length: float, x: np.ndarray, y: np.ndarray, free: np.ndarray) -> Iterator[Kernel]:
    """Yield kernels of flows in one direction that vary across it only: channels, walls, jets.

    Over knots at `x`, `y` (K,), of which some are `free`, within a `length`.
    """
    for way in WAYS:
        across = y * np.cos(way) - x * np.sin(way)
        bell = np.exp(-0.5 * ((across[:, None] - across[None, :]) / length) ** 2)
        yield Kernel('along a line', _directed(way, _spread(bell, free, 1)), 1.0 / len(WAYS))


def _directed(way: float, one: np.ndarray) -> np.ndarray:
    """Return columns (K, R) of a scalar as columns (2 K, R) of a vector along `way` [rad]."""
    return np.concatenate([np.cos(way) * one, np.sin(way) * one])


def _free(against: Against, axes: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return which knots (K,) may differ from zero: not the ends, where a term has faded."""
    if against in (*PERIODIC, 'particle'):
        return np.ones(len(axes[0]), bool)
    inner = [np.r_[False, np.ones(len(axis) - 2, bool), False] for axis in axes]
    if len(inner) == 1:
        return inner[0]
    grid: np.ndarray = (inner[0][:, None] & inner[1][None, :]).ravel()
    return grid


def _spread(covariance: np.ndarray, free: np.ndarray, components: int) -> np.ndarray:
    """Return scaled leading eigenvectors of a `covariance` (K, K), equal for each component."""
    return np.kron(np.eye(components), _leading(covariance, free))


def _leading(covariance: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return scaled leading eigenvectors (K, R) of a `covariance`, zero at knots not `free`."""
    values, vectors = np.linalg.eigh(covariance[np.ix_(free, free)])
    kept = values > KEPT * values[-1]
    scaled = np.zeros((len(free), int(kept.sum())))
    scaled[free] = vectors[:, kept] * np.sqrt(values[kept])
    return scaled


def _of_place(axes: tuple[np.ndarray, ...], free: np.ndarray, components: int) -> Iterator[Kernel]:
    """Yield kernels of fields of place; for velocities also without curl or divergence."""
    x, y = (part.ravel() for part in np.meshgrid(*axes, indexing='ij'))
    dx, dy = x[:, None] - x[None, :], y[:, None] - y[None, :]
    for length in (0.2, 0.4, 0.8):
        bell = np.exp(-0.5 * (dx**2 + dy**2) / length**2)
        yield Kernel('any', _spread(bell, free, components), 1.0)
        if components == 1:
            continue
        xx, yy, xy = 1 - (dx / length) ** 2, 1 - (dy / length) ** 2, -dx * dy / length**2
        yield from _parallel(length, x, y, free)
        both = np.concatenate([free, free])
        for kind, block in (
                ('without circulation', [[xx, xy], [xy, yy]]),
                ('without sources', [[yy, -xy], [-xy, xx]])):
            covariance = np.block(block) * np.tile(bell, (2, 2))
            yield Kernel(kind, _leading(covariance, both), 1.0)


@dataclass(frozen=True)
class _Reduced:
    """A kernel on the data.

    Eigenvalues (R,) of its `information`, projections `found` (R,) of the data on the
    eigenvectors, and these as `tables` (K·C, R).
    """

    kernel: Kernel
    information: np.ndarray
    found: np.ndarray
    tables: np.ndarray

    @classmethod
    def of(cls, kernel: Kernel, gram: np.ndarray, projection: np.ndarray) -> _Reduced:
        inside = kernel.basis.T @ gram @ kernel.basis
        values, vectors = np.linalg.eigh(inside)
        tables = kernel.basis @ vectors
        return cls(kernel, np.maximum(values, 0.0), tables.T @ projection, tables)

    @cached_property
    def amplitudes(self) -> np.ndarray:
        """Prior variance a for each of STRENGTHS."""
        return STRENGTHS / max(float(self.information.sum()), 1e-300)

    @cached_property
    def log_evidence(self) -> np.ndarray:
        """Log of the marginal likelihood over that of a zero table, for each amplitude."""
        a = self.amplitudes[:, None]
        return (-0.5 * np.log1p(a * self.information) + 0.5 * a * self.found**2 / (
            1 + a * self.information)).sum(axis=1)


@dataclass(frozen=True)
class Curve:
    """Posterior of a table, averaged over kernels and strengths."""

    reduced: tuple[_Reduced, ...]

    @classmethod
    def of(cls, tried: list[Kernel], gram: np.ndarray, projection: np.ndarray) -> Curve:
        """Compute the posterior for several kernels.

        Parameters
        ----------
        tried : list of Kernel
            The kernels.
        gram : ndarray, shape (K, K)
            Information G on the values at the knots.
        projection : ndarray, shape (K,)
            Projection b of the data on the knots.

        Returns
        -------
        Curve
            The posterior.
        """
        return cls(tuple(_Reduced.of(kernel, gram, projection) for kernel in tried))

    def given(self, projection: np.ndarray) -> Curve:
        """Compute the posterior for other data of the same design.

        Parameters
        ----------
        projection : ndarray, shape (K,)
            Projection b of the data on the knots.

        Returns
        -------
        Curve
            The posterior, with the same kernels.
        """
        return Curve(tuple(replace(one, found=one.tables.T @ projection) for one in self.reduced))

    @cached_property
    def log_weights(self) -> np.ndarray:
        """Log of prior times marginal likelihood, by kernel and strength."""
        return np.stack([
            np.log(one.kernel.share / len(STRENGTHS)) + one.log_evidence for one in self.reduced])

    @cached_property
    def log_evidence(self) -> float:
        """Log of the marginal likelihood of the table over that of a zero table."""
        return float(np.logaddexp.reduce(self.log_weights, axis=None))

    @cached_property
    def _weights(self) -> np.ndarray:
        weights: np.ndarray = np.exp(self.log_weights - self.log_evidence)
        return weights

    @cached_property
    def mean(self) -> np.ndarray:
        """Posterior mean at the knots (K,)."""
        total = np.zeros(len(self.reduced[0].tables))
        for one, weights in zip(self.reduced, self._weights, strict=True):
            for a, weight in zip(one.amplitudes, weights, strict=True):
                if weight > 1e-6:
                    total += weight * (one.tables @ (a * one.found / (1 + a * one.information)))
        return total

    def draws(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw tables from the posterior.

        Parameters
        ----------
        count : int
            Number of tables.
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        ndarray, shape (count, K)
            The tables.
        """
        weights = self._weights.ravel()
        picks = rng.choice(len(weights), size=count, p=weights / weights.sum())
        found = np.empty((count, len(self.reduced[0].tables)))
        for k, pick in enumerate(picks):
            one = self.reduced[pick // len(STRENGTHS)]
            a = one.amplitudes[pick % len(STRENGTHS)]
            left = a / (1 + a * one.information)
            found[k] = one.tables @ (
                left * one.found + np.sqrt(left) * rng.standard_normal(len(left)))
        return found

    @property
    def kind(self) -> str:
        """Kind of kernel of the largest posterior probability."""
        by_kind: dict[str, float] = {}
        for one, weights in zip(self.reduced, self._weights, strict=True):
            by_kind[one.kernel.kind] = by_kind.get(one.kernel.kind, 0.0) + float(weights.sum())
        return max(by_kind, key=by_kind.__getitem__)


def curve_of(moments: Moments) -> Curve:
    """Return the curve of a candidate from all rows.

    Parameters
    ----------
    moments : Moments
        Moments of the candidate.

    Returns
    -------
    Curve
        The posterior, with all kernels of the table.
    """
    return Curve.of(kernels(moments.term), *moments.total)
