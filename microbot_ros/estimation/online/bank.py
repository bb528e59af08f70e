"""Exact filter of position and velocity phasor, under hypotheses of when the phasor changed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from microbot_ros.common.compiled import numba

MIN_WEIGHT = 0.05
"""Probability below which a hypothesis does not contribute to an estimate.

Choice: without it, unlikely wide hypotheses dominate the variance.
"""

LEAST_SHARE = 0.001
"""Least probability of "c wanders" and of "c is constant", relative to the likeliest hypothesis.

Choice: with 0.01 the spread contains a falling speed in 82 instead of 78 % of the time, but the
error of a constant speed is 7 instead of 0.5 % larger.
"""


class Mixture(NamedTuple):
    """Mean and covariance of N particles over hypotheses (see `PhasorBank`).

    Attributes
    ----------
    p, velocity_phasor : ndarray of complex, shape (N,)
        Means of position [m] and of c = v e^{iφ}.
    p_var, phasor_var : ndarray, shape (N,)
        Variances per axis.
    cross : ndarray of complex, shape (N,)
        Half the mean of p̃ c̃*.
    """

    p: np.ndarray
    velocity_phasor: np.ndarray
    p_var: np.ndarray
    phasor_var: np.ndarray
    cross: np.ndarray


_TINY = np.finfo(float).tiny  # divides 0 without harm


class PhasorBank:
    """Kalman filters of (p, c, s) in dp = c dU − i b s + dW + diffusion, z = p + noise.

    p is the position [m] and c the `velocity_phasor` v e^{iφ} [m/s, for rollers m/s/Hz]; all
    arrays are (K, N), for K hypotheses and N particles.

    All is complex (x + iy) and isotropic, so one particle needs one complex pair. The covariance
    is factorised: `phasor_var` is Var c, `g` the regression of p on c and `p_var` the variance of
    p given c (each per axis), P = [[p_var + |g|² Var c, g Var c], [·, Var c]]. Every factor is
    updated by products of positive numbers, so P is positive definite by construction. With
    constant c the recursion is least squares on increments that are whitened exactly for diffusion
    and localisation noise.

    Where headings align at a finite rate, rotational diffusion makes them deviate by η from the
    course of the model. A deviation decays slowly, or grows while a turn is sharper than 90°. In
    the frame of c it is s = i c η, and displacements gain −i b s, with b the derivative of
    ∫e^{i(θ−φ)} dt by the heading. That is linear again. The noise acts across the direction of
    travel; its variance is split equally between the axes, which keeps the covariance isotropic.
    Given c, s has variance `s_var`, regression `gs` on c, and covariance `ps` = ½ E p̃ s̃*. All
    four are 0 until `predict_deviation`.

    Hypothesis 0 is "nothing changed"; slot j > 0 is "c changed when this slot was opened". Slot j
    is reopened every 2ʲ ticks (the last as often as the one before it), so the bank always has
    moments of change spread evenly over the logarithm of the age. An abrupt change finds a filter
    that started at the right moment, without process noise that would blur the steady state. (The
    run-length posterior of Bayesian online change-point detection, Adams & MacKay 2007, on a fixed
    grid.)

    The last hypotheses are "c wanders", each at its own pace. They are never reopened, and their
    probability stays above LEAST_SHARE, so that a speed that begins to wander or to fall is
    followed. Where all others are less likely than that, hypothesis 0 starts again from the
    likeliest of these.

    Parameters
    ----------
    changes : int
        Number of hypotheses of the first two kinds.
    paces : sequence of float, optional
        Variance that wandering adds to c under each of the others, as a multiple of that under
        the first.
    """

    _ARRAYS: ClassVar[tuple[str, ...]] = (
        'p', 'velocity_phasor', 'g', 'p_var', 'phasor_var', 'log_weight', 's', 'gs', 'ps', 's_var')
    """Names of all arrays (K, N)."""

    def __init__(self, changes: int, paces: Sequence[float] = ()) -> None:
        shape = (changes + len(paces), 0)
        self._changes = changes
        self._paces = np.array([*[1.0] * changes, *paces])
        self.p = np.zeros(shape, complex)
        self.velocity_phasor = np.zeros(shape, complex)
        self.g = np.zeros(shape, complex)
        self.p_var = np.zeros(shape)
        self.phasor_var = np.zeros(shape)
        self.log_weight = np.zeros(shape)
        self.s, self.gs, self.ps = np.zeros((3, *shape), complex)
        self.s_var = np.zeros(shape)
        self._ticks = 0

    def add(self, position: np.ndarray, p_var: np.ndarray, phasor_var: float) -> None:
        """Append particles with c = 0 ± √`phasor_var`.

        Parameters
        ----------
        position : ndarray of complex, shape (n,)
            Positions [m].
        p_var : ndarray, shape (n,)
            Variances of the positions per axis [m²].
        phasor_var : float
            Variance of c per axis [m²/s²].
        """
        for name, born in self._births(position, p_var, phasor_var).items():
            setattr(self, name, np.concatenate([getattr(self, name), born], axis=1))

    def _births(
        self, position: np.ndarray, p_var: np.ndarray, phasor_var: float,
    ) -> dict[str, np.ndarray]:
        """Return the columns (K, n) of particles of which only the position is known."""
        shape = self.p.shape[0], len(position)
        log_weight = np.full(shape, -np.inf)
        log_weight[0] = 0.0
        log_weight[self._changes:] = math.log(LEAST_SHARE)
        return {
            'p': np.broadcast_to(position, shape), 'velocity_phasor': np.zeros(shape, complex),
            'g': np.zeros(shape, complex), 'p_var': np.broadcast_to(p_var, shape),
            'phasor_var': np.full(shape, phasor_var), 'log_weight': log_weight,
            **dict(zip(('s', 'gs', 'ps'), np.zeros((3, *shape), complex), strict=True)),
            's_var': np.zeros(shape),
        }

    def scale_velocity_phasor(self, factor: complex) -> None:
        """Multiply every c by a factor.

        Parameters
        ----------
        factor : complex
            Factor of a size near 1.
        """
        self.velocity_phasor *= factor

    def keep(self, particles: np.ndarray) -> None:
        """Remove all other particles.

        Parameters
        ----------
        particles : ndarray
            Mask (N,) or indices (n,) of the particles that stay.
        """
        for name in self._ARRAYS:
            # Another memory layout would be compiled separately.
            setattr(self, name, getattr(self, name)[:, particles].copy('C'))

    def predict_deviation(
        self, sensitivity: np.ndarray, retention: np.ndarray, heading_noise: float,
    ) -> None:
        """Advance the deviations of headings to the next frame, and p by them; before `predict`.

        Parameters
        ----------
        sensitivity : ndarray of complex, shape (N,)
            Derivative of the path by the heading at the last frame [s], from
            `model.increments.heading_response`.
        retention : ndarray, shape (N,)
            Fraction of a deviation that remains at the next frame.
        heading_noise : float
            Variance 2 D_r h that rotational diffusion adds [rad²].
        """
        b = -1j * sensitivity
        floor = 1e-9 * (self.p_var + np.abs(b) ** 2 * self.s_var)
        self.p += b * self.s
        self.g += b * self.gs
        self.p_var = np.maximum(
            self.p_var + 2 * np.real(np.conj(b) * self.ps) + np.abs(b) ** 2 * self.s_var, floor
        )
        self.s *= retention
        self.gs *= retention
        ps = retention * (self.ps + b * self.s_var)
        added = np.abs(self.velocity_phasor) ** 2 * heading_noise / 2
        self.s_var = retention**2 * self.s_var + added
        self.ps = _bounded(ps, self.p_var, self.s_var)

    def predict(
        self, path: np.ndarray, drift: np.ndarray, diffused: float, wander: np.ndarray,
    ) -> None:
        """Advance to the next frame.

        Parameters
        ----------
        path : ndarray of complex, shape (1 or N,)
            ∫u dt [s]: displacement per unit c.
        drift : ndarray of complex, shape (1 or N,)
            Displacement by drift [m].
        diffused : float
            Variance 2Dh that diffusion adds [m²].
        wander : ndarray, shape (N,)
            Variance that is added to c under the first hypotheses.
        """
        _predict(self.p, self.velocity_phasor, self.g, self.p_var, self.phasor_var, path, drift,
                 diffused, wander, self._paces)

    def update(self, z: np.ndarray, noise: np.ndarray, seen: np.ndarray) -> None:
        """Update with positions.

        Parameters
        ----------
        z : ndarray of complex, shape (N,)
            Positions [m].
        noise : ndarray, shape (N,)
            Variances of the readings [m²].
        seen : ndarray of bool, shape (N,)
            Which particles have a reading.
        """
        _update(self.p, self.velocity_phasor, self.g, self.p_var, self.phasor_var,
                self.log_weight, self.s, self.gs, self.ps, self.s_var, z, noise, seen)

    def restart(
        self, rows: np.ndarray, z: np.ndarray, noise: np.ndarray, phasor_var: float,
    ) -> None:
        """Restart particles whose predictions failed.

        They may have been moved, or their c may have changed: two hypotheses of equal probability,
        c as known and c = 0 ± √`phasor_var`, between which later readings decide.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
            Indices of the particles.
        z : ndarray of complex, shape (n,)
            Positions [m].
        noise : ndarray, shape (n,)
            Variances of the positions [m²].
        phasor_var : float
            Variance of an unknown c per axis [m²/s²].
        """
        known = self.combined()
        for name, born in self._births(z, noise, phasor_var).items():
            getattr(self, name)[:, rows] = born
        self.velocity_phasor[0, rows] = known.velocity_phasor[rows]
        self.phasor_var[0, rows] = known.phasor_var[rows]
        self.log_weight[self._changes - 1, rows] = 0.0

    def tick(
        self, prior_probability: float, change_var: np.ndarray, phasor_var_max: float,
    ) -> np.ndarray:
        """Reopen the slot that is due, with "c changed just now".

        Parameters
        ----------
        prior_probability : float
            Prior probability of a change in one tick.
        change_var : ndarray, shape (N,)
            Variance that a change adds to c on each axis.
        phasor_var_max : float
            Largest variance of c.

        Returns
        -------
        ndarray of int, shape (N,)
            Ticks since c changed, if closing the slot made that certain; else 0.
        """
        self._ticks += 1
        zeros = (self._ticks & -self._ticks).bit_length() - 1
        slot = min(zeros + 1, self._changes - 1)
        age = 2 ** min(slot, self._changes - 2)
        changed = self._fold(slot) > 0.5
        self._share()
        self._open(slot, prior_probability * 2 ** (slot - 1), change_var, phasor_var_max)
        return np.where(changed, age, 0)

    def weights(self) -> np.ndarray:
        """Return the posterior probability of each hypothesis.

        Returns
        -------
        ndarray, shape (K, N)
            Those below MIN_WEIGHT are zero.
        """
        weight: np.ndarray = posterior(self.log_weight)
        return weight

    def combined(self) -> Mixture:
        """Return mean and covariance over all hypotheses.

        Returns
        -------
        Mixture
            One entry per particle.
        """
        return Mixture(*_combine(self.weights(), self.p, self.velocity_phasor, self.g, self.p_var,
                                 self.phasor_var))

    def _share(self) -> None:
        """Keep the probabilities of a wandering and of a constant c above LEAST_SHARE."""
        constant, wandering = np.split(self.log_weight, [self._changes])
        if not len(wandering):
            return
        least = self.log_weight.max(axis=0) + math.log(LEAST_SHARE)
        np.maximum(wandering, least, out=wandering)
        lost = np.flatnonzero(constant.max(axis=0) < least)
        likeliest = self._changes + wandering[:, lost].argmax(axis=0)
        for name in self._ARRAYS:
            array = getattr(self, name)
            array[0, lost] = array[likeliest, lost]
        self.log_weight[0, lost] = least[lost]

    def _fold(self, slot: int) -> np.ndarray:
        """Merge a slot into hypothesis 0 in proportion to its weight; return its share."""
        pair = [0, slot]
        share = posterior(self.log_weight[pair])
        merged = Mixture(*_combine(share, *(
            getattr(self, name)[pair] for name in self._ARRAYS[:5])))
        self.log_weight[0] = np.logaddexp(
            self.log_weight[0], np.where(share[1] > 0, self.log_weight[slot], -np.inf)
        )
        for name in ('p', 'velocity_phasor', 'phasor_var'):
            getattr(self, name)[0] = getattr(merged, name)
        self.g[0] = merged.cross / merged.phasor_var
        left = merged.p_var - np.abs(merged.cross) ** 2 / merged.phasor_var
        # Exactly, a mixture is never narrower than its narrowest part; rounding could be.
        self.p_var[0] = np.maximum(left, self.p_var[pair].min(axis=0))
        changed: np.ndarray = share[1]
        for name in ('s', 'gs', 'ps', 's_var'):
            array = getattr(self, name)
            array[0] = np.where(changed > 0.5, array[slot], array[0])
        self.ps = _bounded(self.ps, self.p_var, self.s_var)
        return changed

    def _open(
        self, slot: int, probability: float, change_var: np.ndarray, phasor_var_max: float,
    ) -> None:
        """Start "c changed just now" from hypothesis 0."""
        known = self.phasor_var[0]
        grown = np.minimum(known + change_var, np.maximum(phasor_var_max, known))
        self.p[slot], self.velocity_phasor[slot] = self.p[0], self.velocity_phasor[0]
        # The position depends on the old c; the new c shares only part of its variance.
        shared = known / grown
        self.p_var[slot] = self.p_var[0] + np.abs(self.g[0]) ** 2 * known * (1 - shared)
        self.g[slot] = self.g[0] * shared
        self.phasor_var[slot] = grown
        self.gs[slot] = self.gs[0] * shared
        self.s[slot], self.ps[slot], self.s_var[slot] = self.s[0], self.ps[0], self.s_var[0]
        self.log_weight[slot] = self.log_weight[0] + np.log(probability)


@numba.njit(cache=True, error_model='numpy')
def _predict(  # type: ignore[no-untyped-def]
        p, c, g, p_var, phasor_var, path, drift, diffused, wander, paces):
    """Advance the arrays of `PhasorBank.predict`; `path` and `drift` are (1 or N,)."""
    hypotheses, count = p.shape
    for n in range(count):
        way, carried = path[min(n, len(path) - 1)], drift[min(n, len(drift) - 1)]
        for k in range(hypotheses):
            p[k, n] += c[k, n] * way + carried
            bent, added = g[k, n] + way, paces[k] * wander[n]
            shrink = phasor_var[k, n] / (phasor_var[k, n] + added)
            p_var[k, n] += diffused
            p_var[k, n] += _square(bent) * phasor_var[k, n] * (1 - shrink)
            g[k, n] = bent * shrink
            phasor_var[k, n] += added


@numba.njit(cache=True, error_model='numpy')
def _update(  # type: ignore[no-untyped-def]
        p, c, g, p_var, phasor_var, log_weight, s, gs, ps, s_var, z, noise, seen):
    """Update the arrays of `PhasorBank.update`."""
    hypotheses, count = p.shape
    for n in range(count):
        best = -np.inf
        for k in range(hypotheses):
            if seen[n]:
                residual, given_c = z[n] - p[k, n], p_var[k, n] + noise[n]
                total = p_var[k, n] + _square(g[k, n]) * phasor_var[k, n] + noise[n]
                kept, deviates = noise[n] / given_c, s_var[k, n] > 0
                if deviates:
                    tie, back = ps[k, n].conjugate(), g[k, n].conjugate() * phasor_var[k, n]
                    s[k, n] += (tie + gs[k, n] * back) / total * residual
                    gs[k, n] -= tie / given_c * g[k, n]
                    # At least the rest after a perfect correlation: positive despite rounding.
                    learned = _square(ps[k, n]) / given_c
                    s_var[k, n] = max(s_var[k, n] - learned, s_var[k, n] * kept)
                c[k, n] += g[k, n].conjugate() * phasor_var[k, n] / total * residual
                p[k, n] += (1 - noise[n] / total) * residual
                phasor_var[k, n] *= given_c / total
                g[k, n] *= kept
                p_var[k, n] *= kept
                if deviates:
                    ps[k, n] = _bounded(ps[k, n] * kept, p_var[k, n], s_var[k, n])
                log_weight[k, n] += -math.log(total) - _square(residual) / (2 * total)
            best = max(best, log_weight[k, n])
        for k in range(hypotheses):
            log_weight[k, n] -= best


@numba.njit(cache=True, error_model='numpy')
def _bounded(ps, p_var, s_var):  # type: ignore[no-untyped-def]
    """Return a covariance of p and s that rounding errors take to no correlation beyond 1."""
    limit = np.sqrt(p_var * s_var)
    return ps * (limit / np.maximum(np.maximum(np.abs(ps), limit), _TINY))


@numba.njit(cache=True, error_model='numpy')
def posterior(log_weight):  # type: ignore[no-untyped-def]
    """Return the probabilities of log weights.

    Parameters
    ----------
    log_weight : ndarray, shape (K, N)
        Log weights of hypotheses.

    Returns
    -------
    ndarray, shape (K, N)
        Those below MIN_WEIGHT are zero.
    """
    weight = np.empty_like(log_weight)
    hypotheses, count = weight.shape
    for n in range(count):
        best, total, kept = log_weight[:, n].max(), 0.0, 0.0
        for k in range(hypotheses):
            weight[k, n] = math.exp(log_weight[k, n] - best)
            total += weight[k, n]
        for k in range(hypotheses):
            weight[k, n] /= total
            if weight[k, n] < MIN_WEIGHT:
                weight[k, n] = 0.0
            kept += weight[k, n]
        for k in range(hypotheses):
            weight[k, n] /= kept
    return weight


@numba.njit(cache=True, error_model='numpy')
def _combine(weight, p, c, g, p_var, phasor_var):  # type: ignore[no-untyped-def]
    """Return the fields of `Mixture` for hypotheses of some weight (K, N)."""
    hypotheses, count = weight.shape
    place, phasor = np.zeros(count, np.complex128), np.zeros(count, np.complex128)
    cross = np.zeros(count, np.complex128)
    place_var, spread = np.zeros(count), np.zeros(count)
    for n in range(count):
        for k in range(hypotheses):
            place[n] += weight[k, n] * p[k, n]
            phasor[n] += weight[k, n] * c[k, n]
        for k in range(hypotheses):
            dp, dc = p[k, n] - place[n], c[k, n] - phasor[n]
            spread[n] += weight[k, n] * (phasor_var[k, n] + _square(dc) / 2)
            place_var[n] += weight[k, n] * (
                p_var[k, n] + _square(g[k, n]) * phasor_var[k, n] + _square(dp) / 2)
            cross[n] += weight[k, n] * (g[k, n] * phasor_var[k, n] + dp * dc.conjugate() / 2)
    return place, phasor, place_var, spread, cross


@numba.njit(cache=True, inline='always')
def _square(z):  # type: ignore[no-untyped-def]
    return z.real * z.real + z.imag * z.imag
