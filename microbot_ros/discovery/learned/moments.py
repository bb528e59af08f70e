"""Sufficient statistics of a table: inner products with the displacement by each knot.

Whitened increments are independent, so their inner products, summed over rows, are sufficient.
Curves and formulas then need matrices of the size of a table, however long the recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from microbot_ros.discovery.learned.candidates import accumulated, steps
from microbot_ros.estimation.likelihood.joint import SessionFit, eliminate, eliminate_shared, inner
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.model.learned_term import LearnedTerm

if TYPE_CHECKING:
    from scipy.sparse import csr_array

FOLDS = 5
"""Number of folds of rows in cross-validation. Choice: the usual five."""

SHORTEST = 2.0
"""Shortest block of rows [s]; every fifth block belongs to one fold.

Choice: longer than usual memories of heading and noise, so that folds are nearly independent; a
longer block leaves too few in short recordings.
"""


@dataclass(frozen=True)
class Moments:
    """Inner products of one candidate term with a fit.

    Attributes
    ----------
    term : LearnedTerm
        The table.
    grams : ndarray, shape (F, tracks, M, M)
        Inner products by fold of rows, in units of the noise. The M columns are the data, v, φ,
        the P parameters of effects, and the knots.
    count : int
        P.
    """

    term: LearnedTerm
    grams: np.ndarray
    count: int

    @classmethod
    def of(cls, fit: ModelFit, term: LearnedTerm, noise: Sequence[float]) -> Moments:
        """Compute the moments of a term beside a fit.

        Parameters
        ----------
        fit : ModelFit
            Fit whose residual is explained.
        term : LearnedTerm
            The table.
        noise : sequence of float
            D of each session [m²/s].

        Returns
        -------
        Moments
            For all sessions.
        """
        folds = []
        for p, jacobian, diffusion in zip(fit.session_fits, fit.jacobian, noise, strict=True):
            scale = np.sqrt(diffusion)
            known = np.concatenate(
                [p.white / scale, jacobian * np.sqrt(p.diffusion) / scale], axis=-1)
            fold = _folds(p.session.times)
            for n, moved in enumerate(steps(fit, p, term)):
                folds.append(_products(p, n, known[:, n], moved / scale, fold))
        return cls(term, np.stack(folds, axis=1), fit.jacobian[0].shape[-1])

    @cached_property
    def total(self) -> tuple[np.ndarray, np.ndarray]:
        """G (K, K) and b (K,) of all knots, with v, φ and the parameters of effects eliminated."""
        return self._reduced(range(FOLDS))

    def without_fold(self, fold: int) -> tuple[np.ndarray, np.ndarray]:
        """Return G and b without the rows of one fold.

        Parameters
        ----------
        fold : int
            The fold that is left out.

        Returns
        -------
        gram : ndarray, shape (K, K)
            Information G.
        projection : ndarray, shape (K,)
            Projection b.
        """
        return self._reduced([k for k in range(FOLDS) if k != fold])

    def _reduced(self, folds: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        gram = self.grams[list(folds)].sum(axis=0)
        left = eliminate_shared(eliminate(gram).sum(axis=0), self.count)
        return left[1:, 1:], left[1:, 0]

    def held_out(self, fold: int, values: np.ndarray) -> float:
        """Return the gain in log likelihood of the rows of a fold by a table.

        v, φ and effects are estimated from the other rows, with and without the table.

        Parameters
        ----------
        fold : int
            The held-out fold.
        values : ndarray, shape (K,)
            Table learned from the other folds.

        Returns
        -------
        float
            Gain over a zero table.
        """
        gains = []
        for table in (values, np.zeros_like(values)):
            gram = self.grams[[k for k in range(FOLDS) if k != fold]].sum(axis=0)
            known = self._solved(gram, table)
            judged = self.grams[fold]
            gains.append(-0.5 * float(np.einsum('ni,nij,nj->', known, judged, known)))
        return gains[0] - gains[1]

    def apart(self, fold: int, one: np.ndarray, other: np.ndarray) -> float:
        """Return the squared distance of two tables in the rows of a fold, in units of the noise.

        It is the variance of the difference of their log likelihoods.

        Parameters
        ----------
        fold : int
            The fold.
        one, other : ndarray, shape (K,)
            The tables.

        Returns
        -------
        float
            Squared distance.
        """
        gram = self.grams[[k for k in range(FOLDS) if k != fold]].sum(axis=0)
        known = self._solved(gram, one) - self._solved(gram, other)
        return float(np.einsum('ni,nij,nj->', known, self.grams[fold], known))

    def _solved(self, gram: np.ndarray, table: np.ndarray) -> np.ndarray:
        """Return the weights (tracks, M) of the columns whose sum is the residual."""
        first = 3 + self.count
        weights = np.zeros(gram.shape[:2])
        weights[:, 0], weights[:, first:] = 1.0, -table
        if self.count:
            left = eliminate(gram).sum(axis=0)
            plain = np.concatenate([[1.0], np.zeros(self.count), -table])
            own = slice(1, 1 + self.count)
            weights[:, 3:first] = -np.linalg.pinv(
                left[own, own], rcond=1e-10, hermitian=True) @ (left[own] @ plain)
        target = np.einsum('nij,nj->ni', gram[:, 1:3], weights)
        square = gram[:, 1:3, 1:3] + 1e-9 * np.eye(2) * np.maximum(
            np.trace(gram[:, 1:3, 1:3], axis1=1, axis2=2), 1e-300)[:, None, None]
        weights[:, 1:3] = -np.linalg.solve(square, target[..., None])[..., 0]
        return weights


def _products(p: SessionFit, n: int, known: np.ndarray, moved: csr_array,
              fold: np.ndarray) -> np.ndarray:
    """Return inner products (F, M, M) by fold of the rows of the n-th track of a session.

    `known` is whitened already; `moved` (T − 1, K) is whitened here. With plain noise this takes
    time in proportion to the few knots that act at one time.
    """
    if p.whitening.is_plain:
        from microbot_ros.estimation.likelihood.kernels import knot_products

        track = np.ascontiguousarray(p.session.pieces[:, n])
        return np.asarray(knot_products(
            p.session.times, track, np.ascontiguousarray(known), moved.indptr, moved.indices,
            moved.data, moved.shape[1], fold, FOLDS, p.whitening.noise_ratio))
    white = np.concatenate([known, whiten_track(p, n, accumulated(moved))], axis=1)
    return np.concatenate([inner(white[fold == k][:, None]) for k in range(FOLDS)])


def whiten_track(p: SessionFit, n: int, moved: np.ndarray) -> np.ndarray:
    """Whiten displacements of one track of a session.

    Parameters
    ----------
    p : SessionFit
        Fit of the session.
    n : int
        Index of the track.
    moved : ndarray of complex, shape (T, M)
        Displacements [m].

    Returns
    -------
    ndarray of complex, shape (T − 1, M)
        Whitened increments, except for the factor 1/√D.
    """
    session, one = p.session, slice(n, n + 1)
    alone = replace(session, ids=session.ids[one], z=session.z[:, one],
                    pieces=np.ascontiguousarray(session.pieces[:, one]),
                    causal_positions=session.causal_positions[:, one], phi=None)
    noise = p.whitening
    if noise.sensitivity is not None and noise.retention is not None:
        noise = replace(noise, sensitivity=np.ascontiguousarray(noise.sensitivity[:, one]),
                        retention=np.ascontiguousarray(noise.retention[:, one]))
    if noise.way is not None and noise.change is not None and noise.stride is not None:
        noise = replace(noise, way=noise.way[:, one], change=noise.change[:, one],
                        stride=noise.stride[:, one])
    white: np.ndarray = noise.apply(alone, np.ascontiguousarray(moved[:, None]))[0][:, 0]
    return white


def _folds(times: np.ndarray) -> np.ndarray:
    """Return the fold (T,) of every frame, from interleaved blocks."""
    duration = float(np.ptp(times))
    length = max(SHORTEST, duration / 40)
    if duration < 2 * FOLDS * length:
        length = duration / (2 * FOLDS)
    return ((times - times[0]) / length).astype(int) % FOLDS
