"""The exact filter for position and velocity phasor, under hypotheses of when that changed."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

MIN_WEIGHT = 0.05
"""Hypotheses less probable than this neither move nor widen an estimate."""


class PhasorBank:
    """Kalman filters for (p, c) in dp = c dU + dW + diffusion, z = p + noise; K hypotheses × N.

    p is the position [m] and c the `velocity_phasor` v e^{iφ} [m/s, for rollers m/s/Hz]; all
    arrays are (K, N). K is the number of `hypotheses`, N that of the particles.

    Everything is complex (x + iy) and isotropic, so one particle needs one complex pair. The
    covariance is kept factorised: `phasor_var` is Var c, `g` the regression of p on c and `p_var`
    the variance of p given c (each per axis), P = [[p_var + |g|² Var c, g Var c], [·, Var c]].
    Every factor is updated by products of positive numbers, so P is positive definite by
    construction, and with constant c the recursion is least squares on increments whitened
    exactly for diffusion and localisation noise.

    Hypothesis 0 is "nothing changed"; slot j > 0 says "c changed when this slot was opened".
    Slot j is reopened every 2ʲ ticks (the last as often as the one before it), so that the bank
    always holds moments of change spread evenly over the logarithm of the age: an abrupt change
    is met by a filter that starts afresh at the right moment, without process noise that would
    blur the steady state. (The run-length posterior of Bayesian online change-point detection,
    Adams & MacKay 2007, on a fixed grid.)
    """

    _ARRAYS: ClassVar[tuple[str, ...]] = (
        'p', 'velocity_phasor', 'g', 'p_var', 'phasor_var', 'log_weight')

    def __init__(self, hypotheses: int) -> None:
        shape = (hypotheses, 0)
        self.p = np.zeros(shape, complex)
        self.velocity_phasor = np.zeros(shape, complex)
        self.g = np.zeros(shape, complex)
        self.p_var = np.zeros(shape)
        self.phasor_var = np.zeros(shape)
        self.log_weight = np.zeros(shape)
        self._ticks = 0

    def add(self, position: np.ndarray, p_var: np.ndarray, phasor_var: float) -> None:
        """Append particles at complex `position` (n,) [m] ± √`p_var`, with c = 0 ± √`phasor_var`.

        Variances per axis, `p_var` (n,) [m²], `phasor_var` [m²/s²].
        """
        hypotheses, n = self.p.shape[0], len(position)
        births = {
            'p': np.broadcast_to(position, (hypotheses, n)),
            'velocity_phasor': np.zeros((hypotheses, n), complex),
            'g': np.zeros((hypotheses, n), complex),
            'p_var': np.broadcast_to(p_var, (hypotheses, n)),
            'phasor_var': np.full((hypotheses, n), phasor_var),
            'log_weight': np.full((hypotheses, n), -np.inf),
        }
        births['log_weight'][0] = 0.0
        for name, born in births.items():
            setattr(self, name, np.concatenate([getattr(self, name), born], axis=1))

    def scale_velocity_phasor(self, factor: complex) -> None:
        """Multiply every c by a complex `factor` near 1, as after a better value of the delay."""
        self.velocity_phasor *= factor

    def keep(self, particles: np.ndarray) -> None:
        """Keep only these columns: `particles` is a mask (N,) or indices (n,)."""
        for name in self._ARRAYS:
            setattr(self, name, getattr(self, name)[:, particles])

    def predict(
        self, path: np.ndarray | complex, drift: np.ndarray | complex, diffused: float,
        wander: float,
    ) -> None:
        """Move on to the next frame: by c · `path`, ∫u dt [s], and `drift` [m], (N,) complex.

        `diffused` = 2Dh [m²] is the variance that diffusion adds, `wander` (N,) that of c.
        """
        self.p += self.velocity_phasor * path + drift
        self.g += path
        self.p_var += diffused
        shrink = self.phasor_var / (self.phasor_var + wander)
        self.p_var += np.abs(self.g) ** 2 * self.phasor_var * (1 - shrink)
        self.g *= shrink
        self.phasor_var += wander

    def innovation(self, z: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`z` (N,) − prediction (K, N) [m], and its variance per axis; `noise` (N,): of `z`."""
        return z - self.p, self.p_var + np.abs(self.g) ** 2 * self.phasor_var + noise

    def update(self, z: np.ndarray, noise: np.ndarray, seen: np.ndarray) -> None:
        """Take positions `z` (N,) read with variance `noise` (N,) [m²] where `seen` (N,)."""
        residual, total = self.innovation(z, noise)
        given_c = self.p_var + noise
        gain_c = np.conj(self.g) * self.phasor_var / total
        gain_p = 1 - noise / total
        residual = np.where(seen, residual, 0)
        self.velocity_phasor += gain_c * residual
        self.p += gain_p * residual
        self.phasor_var *= np.where(seen, given_c / total, 1)
        kept = np.where(seen, noise / given_c, 1)
        self.g *= kept
        self.p_var *= kept
        log_density = -np.log(total) - np.abs(residual) ** 2 / (2 * total)
        self.log_weight += np.where(seen, log_density, 0)
        self.log_weight -= self.log_weight.max(axis=0)

    def restart_position(self, z: np.ndarray, noise: np.ndarray, where: np.ndarray) -> None:
        """Put particles `where` (N,) bool to `z` ± √`noise`, knowing c as before: after a jump."""
        self.p = np.where(where, z, self.p)
        self.g = np.where(where, 0, self.g)
        self.p_var = np.where(where, noise, self.p_var)

    def tick(
        self, prior_probability: float, change_var: np.ndarray, phasor_var_max: float,
    ) -> np.ndarray:
        """Reopen the slot that is due, with "c changed just now" of `prior_probability`.

        `change_var` (N,) is the variance that such a change adds to c on each axis, up to
        `phasor_var_max` in all. Returns the
        ticks since c changed (N,), where the slot's lapse made it certain; else 0.
        """
        self._ticks += 1
        zeros = (self._ticks & -self._ticks).bit_length() - 1
        slot = min(zeros + 1, self.p.shape[0] - 1)
        age = 2 ** min(slot, self.p.shape[0] - 2)
        changed = self._fold(slot) > 0.5
        self._open(slot, prior_probability * 2 ** (slot - 1), change_var, phasor_var_max)
        return np.where(changed, age, 0)

    def weights(self) -> np.ndarray:
        """Posterior probability (K, N) of each hypothesis, those below MIN_WEIGHT set to zero."""
        weight = np.exp(self.log_weight - self.log_weight.max(axis=0))
        weight /= weight.sum(axis=0)
        weight[weight < MIN_WEIGHT] = 0
        return weight / weight.sum(axis=0)

    def combined(self) -> dict[str, np.ndarray]:
        """Mean and covariance over hypotheses: p, c, their variances, and cross = ½ E p̃c̃* (N,)."""
        return self._combine(self.weights())

    def _combine(self, weight: np.ndarray) -> dict[str, np.ndarray]:
        p = (weight * self.p).sum(axis=0)
        c = (weight * self.velocity_phasor).sum(axis=0)
        dp, dc = self.p - p, self.velocity_phasor - c
        spread_c = self.phasor_var + np.abs(dc) ** 2 / 2
        spread_p = self.p_var + np.abs(self.g) ** 2 * self.phasor_var + np.abs(dp) ** 2 / 2
        cross = self.g * self.phasor_var + dp * np.conj(dc) / 2
        return {
            'p': p, 'velocity_phasor': c, 'p_var': (weight * spread_p).sum(axis=0),
            'phasor_var': (weight * spread_c).sum(axis=0), 'cross': (weight * cross).sum(axis=0),
        }

    def _fold(self, slot: int) -> np.ndarray:
        """Merge a slot into hypothesis 0 where it carries weight, else let it lapse; its share."""
        pair = np.exp(self.log_weight[[0, slot]] - self.log_weight[[0, slot]].max(axis=0))
        share = pair / pair.sum(axis=0)
        share[share < MIN_WEIGHT] = 0
        share /= share.sum(axis=0)
        weight = np.zeros_like(self.log_weight)
        weight[[0, slot]] = share
        merged = self._combine(weight)
        self.log_weight[0] = np.logaddexp(
            self.log_weight[0], np.where(share[1] > 0, self.log_weight[slot], -np.inf)
        )
        for name in ('p', 'velocity_phasor', 'phasor_var'):
            getattr(self, name)[0] = merged[name]
        self.g[0] = merged['cross'] / merged['phasor_var']
        left = merged['p_var'] - np.abs(merged['cross']) ** 2 / merged['phasor_var']
        # Exactly, a mixture is never narrower than its narrowest part; rounding could be.
        self.p_var[0] = np.maximum(left, self.p_var[[0, slot]].min(axis=0))
        return share[1]

    def _open(
        self, slot: int, probability: float, change_var: np.ndarray, phasor_var_max: float,
    ) -> None:
        """Start "c changed just now" from hypothesis 0."""
        known = self.phasor_var[0]
        grown = np.minimum(known + change_var, np.maximum(phasor_var_max, known))
        self.p[slot], self.velocity_phasor[slot] = self.p[0], self.velocity_phasor[0]
        # The old c placed the particle; the new c is independent of that beyond what is shared.
        shared = known / grown
        self.p_var[slot] = self.p_var[0] + np.abs(self.g[0]) ** 2 * known * (1 - shared)
        self.g[slot] = self.g[0] * shared
        self.phasor_var[slot] = grown
        self.log_weight[slot] = self.log_weight[0] + np.log(probability)
