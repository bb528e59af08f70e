"""Noise of a session whose velocities fluctuate, at the maximum of the restricted likelihood.

The deviation of every speed and direction is an Ornstein–Uhlenbeck process in the filter that
whitens the positions. Its parameters are searched by Fisher scoring: each step solves for the
vertex of a parabola whose curvature is the expected information. All derivatives are forward
differences of whitened residuals and of the factors that whiten them, so that one filter pass per
parameter yields the slope and the curvature.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from microbot_ros.estimation.likelihood.joint import (
    ENOUGH,
    LARGEST,
    SMALLEST,
    SessionFit,
    Whitening,
    columns_of,
    inner,
)
from microbot_ros.model.model import Model

SHORTEST, LONGEST, PART = 2.0, 5.0, 0.05
"""Bounds of the correlation time of speeds: at least this many frame intervals, at most `LONGEST`
seconds, and at most the fraction `PART` of the recording.

Choice: what lasts longer is a trend, which has other names."""

LEAST = 0.01
"""Smallest strength of a fluctuation: a fraction of the speed, or of a frame interval [s]; and of
the wander over it, or of a swing.

Choice: with half or twice of it the log likelihood changes by less than 0.1."""

WIDEST = 1e9
"""Ratio of the largest to the smallest variance of a kind of noise.

Choice: far beyond any result.
"""

STARTS = 0.2, 2.0
"""Correlation times [s] from which the search starts. Choice: either side of usual ones."""

DIFFERENCE = 1e-3
"""Change of the logarithm of a parameter for derivatives.

Choice: rounding and curvature both change slopes by less than a thousandth.
"""

FARTHEST = 2.0
"""Largest change of the logarithm of a parameter in one step.

Choice: beyond a factor of 7 a parabola says nothing; a smaller value costs steps.
"""

FLAT = 1e-10
"""Curvature, relative to the largest, of directions that count as flat.

Choice: above rounding errors.
"""

ROUNDS = 30
"""Maximum number of steps. Choice: it bounds the time; usually 1 to 10 suffice."""

MOVES = 1e-12
"""Displacement [m] between frames that counts as none. Choice: far below localisation errors."""


def fluctuating(fit: SessionFit, time: float) -> Whitening:
    """Return the noise of a fit with fluctuating velocities.

    Parameters
    ----------
    fit : SessionFit
        Fit of the session.
    time : float
        Correlation time [s].

    Returns
    -------
    Whitening
        Of the same strengths as the fit's.
    """
    interval = np.diff(fit.session.times)[:, None]
    moved = fit.moved
    length = np.abs(moved)
    way = np.where(length > MOVES, moved / np.maximum(length, MOVES), 0)
    velocity = np.pad(moved / interval, ((1, 1), (0, 0)), mode='edge')
    # A change within one interval shows in three, by a half, all and a half of it: 3/2 in all.
    change = np.abs(velocity[2:] - velocity[:-2]) ** 2 / 1.5
    return _correlated(replace(
        fit.whitening, way=np.concatenate([way[:1], way]), change=change,
        stride=way * np.sqrt(length)), moved, interval, time)


def _correlated(noise: Whitening, moved: np.ndarray, interval: np.ndarray,
                time: float) -> Whitening:
    """Return `noise` with another correlation `time` [s] of velocities.

    `moved` (T − 1, N) [m] is the motion in every `interval` (T − 1, 1) [s].
    """
    retention = np.exp(-interval / time)
    # A deviation at the start of an interval acts for as long as it lasts.
    sensitivity = moved * ((1 - retention) * time / interval)
    return replace(
        noise, fluctuation=time, sensitivity=np.ascontiguousarray(sensitivity),
        retention=np.ascontiguousarray(np.broadcast_to(retention, sensitivity.shape)))


def fit_fluctuation(fit: SessionFit, model: Model) -> SessionFit:
    """Fit the noise of a session with fluctuating velocities.

    Commands that act early or late, uneven steps and the swing of rollers are part of it. The
    search climbs from the noise of the fit, or from STARTS where its velocities are steady.

    Parameters
    ----------
    fit : SessionFit
        Fit of the session.
    model : Model
        Its model.

    Returns
    -------
    SessionFit
        The same displacements with new noise.
    """
    session, known = fit.session, fit.whitening
    h, rolls = session.interval, model.propulsion == 'rolling'
    longest = min(LONGEST, PART * float(np.ptp(session.times)))
    if longest <= SHORTEST * h or (known.fluctuation is None and longest <= min(STARTS)):
        return fit
    total = known.noise_ratio + h / 3
    speed = float(np.abs(fit.moved).mean()) / h
    unit = max(speed, MOVES / h)
    # Over D: (reading, speed, correlation time, wander, jitter, unevenness, swing).
    if known.fluctuation is None:
        starts = [(total, 0.3**2 / (time * fit.diffusion), time, 0.1, (h / 4)**2 / fit.diffusion,
                   0.1 / unit, total) for time in STARTS if time < longest]
    else:
        starts = [(total, known.diffusion_ratio, known.fluctuation, known.wander,
                   known.jitter_ratio, known.uneven_ratio, known.swing_ratio)]
    low = np.log([SMALLEST * h, LEAST**2 / (longest * fit.diffusion), SHORTEST * h, LEAST,
                  (LEAST * h)**2 / fit.diffusion, LEAST / unit, LEAST * h])
    high = low + np.log(WIDEST)
    high[[0, 2, 3]] = np.log([LARGEST * h, longest, 1 / LEAST])
    count = len(low) if rolls else len(low) - 1

    some = replace(fluctuating(fit, longest), stretch=model.stretch)
    moved, interval = fit.moved, np.diff(session.times)[:, None]

    @lru_cache(2)
    def correlated(time: float) -> Whitening:
        return _correlated(some, moved, interval, time)

    def noise_at(u: np.ndarray) -> Whitening:
        around, speed, time, wander, jitter, uneven, *swing = np.exp(u).tolist()
        return replace(
            correlated(time), noise_ratio=around - h / 3, diffusion_ratio=speed, wander=wander,
            jitter_ratio=jitter, uneven_ratio=uneven, swing_ratio=swing[0] if rolls else 0.0)

    begun = [np.clip(np.log(np.maximum(of, 1e-300)), low, high)[:count] for of in starts]
    tried = [SessionFit.of(session, noise_at(u), fit.expected) for u in begun]
    best = max(range(len(tried)), key=lambda k: tried[k].restricted_log_likelihood)
    return _climb(tried[best], noise_at, begun[best], low[:count], high[:count])


def _climb(fit: SessionFit, noise_at: Callable[[np.ndarray], Whitening], u: np.ndarray,
           low: np.ndarray, high: np.ndarray) -> SessionFit:
    """Maximise ℓ_R from a `fit` at coordinates `u` (P,) on, within the bounds `low` and `high`."""
    damping = 0.0
    for _ in range(ROUNDS):
        slope, information = _parabola(
            fit, noise_at, u, np.where(u < high, DIFFERENCE, -DIFFERENCE))
        if not (np.isfinite(slope).all() and np.isfinite(information).all()):
            return fit
        least, most = np.maximum(low - u, -FARTHEST), np.minimum(high - u, FARTHEST)
        for _ in range(8):
            step = _vertex(
                slope, information + damping * np.diag(np.diag(information)), least, most)
            foretold = float(2 * slope @ step - step @ information @ step)
            if foretold < ENOUGH:
                return fit
            better = SessionFit.of(fit.session, noise_at(u + step), fit.expected)
            gain = 2 * (better.restricted_log_likelihood - fit.restricted_log_likelihood)
            if gain > 0:
                break
            damping = max(8 * damping, 0.1)
        else:
            return fit
        fit, u, damping = better, u + step, damping / 8 if gain > foretold / 2 else damping
    return fit


def _vertex(slope: np.ndarray, information: np.ndarray, least: np.ndarray,
            most: np.ndarray) -> np.ndarray:
    """Return the step (P,) to the highest point of a parabola within bounds."""
    from scipy.optimize import lsq_linear

    power, axes = np.linalg.eigh(information)
    size = np.sqrt(np.maximum(power, FLAT * power[-1]))
    found: np.ndarray = lsq_linear(
        (axes * size).T, axes.T @ slope / size, (least, most), method='bvls').x
    return found


def _parabola(fit: SessionFit, noise_at: Callable[[np.ndarray], Whitening], u: np.ndarray,
              step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slope (P,) and expected information (P, P) of ℓ_R at coordinates `u` (P,).

    By differences over a `step` (P,). A parameter changes the whitened residual r, of covariance
    D, by w = L⁻¹ times the change of the mean, plus M r, where M is the change of the factors L⁻¹
    times L. The information is Σ w·w/D + ½ tr (M + Mᵀ)(M + Mᵀ), from which D is eliminated.
    """
    session, expected = fit.session, fit.expected
    columns = columns_of(session, expected)

    def rows(noise: Whitening) -> tuple[float, np.ndarray, np.ndarray]:
        white, log_det, count, factors = noise.apply_with_factors(session, columns)
        one = SessionFit(session, noise, expected, inner(white), log_det, count, white)
        used = factors[..., 0] > 0
        left = one.residual[used] * math.sqrt(one.diffusion / fit.diffusion)
        return one.restricted_log_likelihood, factors[used].T[:3], left

    likelihood, (a, b, c), left = rows(fit.whitening)
    slope, parts = np.empty(len(u)), np.empty((len(u), 5, len(left)))
    for k, by in enumerate(step):
        more, (da, db, dc), changed = rows(noise_at(u + by * (np.arange(len(u)) == k)))
        slope[k], changed = (more - likelihood) / by, (changed - left) / by
        x, z = (da / a - 1) / by, (dc / c - 1) / by
        y = ((db - b) / by - z * b) / a
        parts[k] = (math.sqrt(2) * x, y, math.sqrt(2) * z,
                    changed.real - x * left.real, changed.imag - y * left.real - z * left.imag)
    flat, logs = parts.reshape(len(u), -1), parts[:, [0, 2]].sum(axis=(1, 2)) / math.sqrt(2)
    return slope, flat @ flat.T - np.outer(logs, logs) / max(len(left), 1)
