"""The exact likelihood of a model on sessions: v and φ of all particles, D and σ in closed form.

A model is linear in v e^{iφ} of every particle, so only the parameters of its effects are searched
(variable projection: Golub and Pereyra 1973; the Jacobian is Kaufman's, 1975).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ros.discovery.evidence import Evidence, Levels, levels
from microbot_ros.model.increments import heading_response
from microbot_ros.model.model import Model, ParticleParameters

REMEMBERED = 0.01
"""Below this part of a turn that is left at the next frame, headings have no memory."""

ROUNDS = 8
"""Turns in which effects and noise are fitted, at most."""

COLLINEAR = 1e-7
"""Part of a column's power below which v and φ absorb it."""


@dataclass(frozen=True)
class Whitening:
    """The filter that makes a session's noise white, for D = 1.

    `excess` [s] is σ²/D less a third of the exposure. Where headings remember their jitter,
    `turning` is D_r/D, with `bend` and `kept` (T−1, N) of `whiten_turning`; else 0.
    """

    excess: float
    turning: float = 0.0
    bend: np.ndarray | None = None
    kept: np.ndarray | None = None

    def apply(self, evidence: Evidence, columns: np.ndarray) -> tuple[np.ndarray, float, int]:
        """White columns (T, N, M), ½ log det of the covariance over both axes, rows used."""
        if self.bend is None:
            from microbot_ros.estimation.kernels import whiten_levels

            return whiten_levels(evidence.times, evidence.seen, columns, self.excess)
        from microbot_ros.discovery.kernels import whiten_turning

        return whiten_turning(
            evidence.times, evidence.seen, columns, self.excess, self.turning, self.bend,
            self.kept)


@dataclass(frozen=True)
class Part:
    """One session under a model: everything that follows in closed form.

    `white` (T, N, 3) are the data less the offset, and the columns along and across, of unit
    variance but for D; `gram` (particles, 3, 3) their real inner products: pieces of one track
    share v and φ.
    """

    evidence: Evidence
    whitening: Whitening
    levels: Levels
    white: np.ndarray
    gram: np.ndarray
    log_det: float
    count: int

    @cached_property
    def swim(self) -> np.ndarray:
        """v e^{iφ} (N,) of every track; 0 where nothing drove it."""
        solved = _solve(self.gram[:, 1:, 1:], self.gram[:, 1:, :1])[..., 0]
        own: np.ndarray = (solved[:, 0] + 1j * solved[:, 1])[self.evidence.owner]
        return own

    @cached_property
    def squares(self) -> float:
        """Residual sum of squares [m²/s]: D times χ²."""
        return float(eliminate(self.gram).sum())

    @cached_property
    def freedom(self) -> int:
        """Degrees of freedom that are left."""
        driven = int((np.trace(self.gram[:, 1:, 1:], axis1=1, axis2=2) > 0).sum())
        return max(2 * (self.count - driven), 1)

    @property
    def diffusion(self) -> float:
        """D [m²/s] at its maximum."""
        return max(self.squares / self.freedom, 1e-30)

    @cached_property
    def log_likelihood(self) -> float:
        """Restricted to what v and φ leave: with D at its maximum."""
        return -0.5 * self.freedom * (np.log(2 * np.pi * self.diffusion) + 1) - self.log_det

    @cached_property
    def residual(self) -> np.ndarray:
        """White residual (T, N) complex, of unit variance per axis; 0 in rows not used."""
        fitted = self.white[..., 1] * self.swim.real + self.white[..., 2] * self.swim.imag
        residual: np.ndarray = (self.white[..., 0] - fitted) / np.sqrt(self.diffusion)
        return residual

    @property
    def seen_at_once(self) -> float:
        """How many particles are used in a frame, on average."""
        return self.count / len(self.evidence.times)

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Other columns (T, N, M) of levels through the same filter, in units of the noise."""
        white = self.whitening.apply(self.evidence, np.ascontiguousarray(columns, complex))[0]
        white /= np.sqrt(self.diffusion)
        return white


def part(model: Model, evidence: Evidence, whitening: Whitening,
         known: Levels | None = None) -> Part:
    """A session under a model with given effects; `known` levels are not computed again."""
    expected = levels(model, evidence) if known is None else known
    turned = expected.turned and whitening.bend is None
    wanted = [evidence.z - expected.offset, expected.along]
    if not turned:
        wanted.append(expected.across)
    columns = np.empty((*evidence.z.shape, len(wanted)), complex)
    for k, column in enumerate(wanted):
        columns[..., k] = column
    white, log_det, count = whitening.apply(evidence, columns)
    if turned:
        white = np.concatenate([white, 1j * white[..., 1:2]], axis=-1)
    return Part(evidence, whitening, expected, white, inner(white, evidence), log_det, count)


def inner(columns: np.ndarray, evidence: Evidence) -> np.ndarray:
    """Real inner products (particles, M, M) of complex columns (T, N, M) of all their tracks."""
    real = np.ascontiguousarray(columns.transpose(1, 2, 0)).view(float)
    of_tracks: np.ndarray = real @ real.transpose(0, 2, 1)
    if len(of_tracks) == evidence.owner[-1] + 1:
        return of_tracks
    product: np.ndarray = np.add.reduceat(of_tracks, evidence.first_track)
    return product


def eliminate(gram: np.ndarray) -> np.ndarray:
    """Inner products (N, M−2, M−2) of columns 0, 3, 4, … after columns 1 and 2 are taken out."""
    rest = [0, *range(3, gram.shape[-1])]
    mixed = gram[:, 1:3, rest]
    left: np.ndarray = gram[:, rest][:, :, rest] - np.swapaxes(mixed, 1, 2) @ _solve(
        gram[:, 1:3, 1:3], mixed)
    return left


def _solve(square: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions for (N, 2, 2) matrices; zero where there is nothing to solve for."""
    power = np.trace(square, axis1=1, axis2=2)[:, None, None]
    safe = square + np.where(power > 0, 1e-12 * power, 1.0) * np.eye(2)
    solved: np.ndarray = np.linalg.solve(safe, right)
    return solved


@dataclass(frozen=True)
class Fit:
    """A model on all sessions together, each with its own noise."""

    model: Model
    parts: tuple[Part, ...]

    @cached_property
    def log_likelihood(self) -> float:
        """Of all sessions."""
        return sum(p.log_likelihood for p in self.parts)

    @property
    def cost(self) -> float:
        """−2 log likelihood."""
        return -2 * self.log_likelihood

    @property
    def count(self) -> int:
        """Numbers that were measured: two for every row used."""
        return 2 * sum(p.count for p in self.parts)

    @cached_property
    def jacobian(self) -> tuple[np.ndarray, ...]:
        """For each session, white derivatives (T, N, P) of what is expected, in fit coordinates.

        At fixed v and φ, in units of the noise.
        """
        steps = _steps(self.model)
        x = self.model.vector()
        changed = [self.model.with_vector(x + step * unit)
                   for step, unit in zip(steps, np.eye(len(x)), strict=True)]
        white = []
        for p in self.parts:
            here = p.levels.moved(p.swim)
            columns = np.empty((*p.evidence.z.shape, len(x)), complex)
            for k, model in enumerate(changed):
                columns[..., k] = (levels(model, p.evidence).moved(p.swim) - here) / steps[k]
            white.append(p.whiten(columns))
        return tuple(white)

    @cached_property
    def normal(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """JᵀJ (P, P), Jᵀr (P,) with v and φ taken out, and which parameters they leave visible."""
        total = np.zeros((1 + len(self.model.vector()),) * 2)
        raw = np.zeros(len(total))
        for p, jacobian in zip(self.parts, self.jacobian, strict=True):
            all_columns = np.concatenate([p.white / np.sqrt(p.diffusion), jacobian], axis=-1)
            gram = inner(all_columns, p.evidence)
            total += eliminate(gram).sum(axis=0)
            raw[1:] += np.diagonal(gram, axis1=1, axis2=2)[:, 3:].sum(axis=0)
        visible = np.diag(total)[1:] > COLLINEAR * raw[1:]
        return total[1:, 1:], total[1:, 0], visible

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the effects' parameters in fit coordinates (P, P); infinite where not visible."""
        information, _, visible = self.normal
        result = np.diag(np.where(visible, 0.0, np.inf))
        if visible.any():
            chosen = np.ix_(visible, visible)
            result[chosen] = np.linalg.pinv(information[chosen], hermitian=True)
        # Rounding may give what can hardly be told apart a variance below zero.
        variance = np.diagonal(result)
        np.fill_diagonal(result, np.where(variance > 0, variance, np.inf))
        return result


def _steps(model: Model) -> np.ndarray:
    """Steps of the difference quotients, away from the upper bounds."""
    x = model.vector()
    high = np.array([p.fit_bounds[1] for _, p in model.parameters])
    step = 1e-5 * (1 + np.abs(x))
    return np.where(x + step <= high, step, -step)


def evaluate(model: Model, evidences: Sequence[Evidence],
             whitenings: Sequence[Whitening]) -> Fit:
    """A model with its parameters as they are."""
    return Fit(model, tuple(map(lambda e, w: part(model, e, w), evidences, whitenings)))


def maximise(fit: Fit, iterations: int = 20) -> Fit:
    """Improve the effects' parameters within their bounds, by Levenberg and Marquardt's method.

    The noise filters stay as they are.
    """
    if not fit.model.effects:
        return fit
    low, high = np.array([p.fit_bounds for _, p in fit.model.parameters]).T
    angle = np.array([p.shape and p.name.endswith('_rad') for _, p in fit.model.parameters])
    low, high = np.where(angle, -np.inf, low), np.where(angle, np.inf, high)
    damping = 1e-3
    for _ in range(iterations):
        better, damping = _improve(fit, low, high, angle, damping)
        if better is None:
            return fit
        gain, fit = fit.cost - better.cost, better
        if gain < 1e-3:
            return fit
    return fit


def _improve(fit: Fit, low: np.ndarray, high: np.ndarray, angle: np.ndarray,
             damping: float) -> tuple[Fit | None, float]:
    """One step downhill, or None where there is none; and the damping to go on with."""
    information, slope, visible = fit.normal
    x = fit.model.vector()
    free = visible & ~((x <= low) & (slope < 0)) & ~((x >= high) & (slope > 0))
    if not free.any():
        return None, damping
    chosen = np.ix_(free, free)
    for _ in range(8):
        damped = information[chosen] + damping * np.diag(np.diag(information)[free])
        trial = x.copy()
        trial[free] += np.linalg.lstsq(damped, slope[free], rcond=1e-14)[0]
        trial = np.clip(trial, low, high)
        trial[angle] = (trial[angle] + np.pi) % (2 * np.pi) - np.pi
        evidences, whitenings = zip(*((p.evidence, p.whitening) for p in fit.parts), strict=True)
        tried = evaluate(fit.model.with_vector(trial), evidences, whitenings)
        if tried.cost < fit.cost:
            return tried, damping / 5
        damping *= 8
    return None, damping


def with_noise(fit: Fit) -> Fit:
    """The same model with every session's noise at its maximum."""
    return Fit(fit.model, tuple(_renoise(fit.model, p) for p in fit.parts))


def _renoise(model: Model, p: Part) -> Part:
    from scipy.optimize import minimize_scalar

    h = p.evidence.interval
    heading = _heading(model, p) if remembers(model, p.evidence) else None

    def at(log_total: float, turning: float = 0.0) -> Part:
        excess = float(np.exp(log_total)) - h / 3
        whitening = Whitening(excess, turning / p.diffusion, *heading) if heading else (
            Whitening(excess))
        return part(model, p.evidence, whitening, p.levels)

    def best(turning: float = 0.0) -> Part:
        found = minimize_scalar(
            lambda u: -at(u, turning).log_likelihood, method='bounded',
            bounds=(np.log(0.05 * h), np.log(1e3 * h)), options={'xatol': 0.02})
        return at(found.x, turning)

    if heading is None:
        return best()
    if p.evidence.turning is not None:
        return best(p.evidence.turning)
    found = minimize_scalar(
        lambda u: -at(np.log(p.whitening.excess + h / 3), float(np.exp(u))).log_likelihood,
        method='bounded', bounds=(np.log(1e-5), np.log(10.0)), options={'xatol': 0.1})
    return best(float(np.exp(found.x)))


def remembers(model: Model, evidence: Evidence) -> bool:
    """Whether a kick to the heading is still felt at the next frame."""
    if model.effect('alignment_lag'):
        return True
    on = np.hypot(*evidence.commands.field.T) > 0
    later = evidence.commands.t > evidence.times[0]
    return not on[later].all()


def _heading(model: Model, p: Part) -> tuple[np.ndarray, np.ndarray]:
    """What a turn does over every frame interval, and what is left of it: (T−1, N) each."""
    particles = ParticleParameters.from_velocity_phasor(p.evidence.ids, p.swim)
    response = heading_response(model, particles, p.evidence.timeline)
    bend = np.nan_to_num(response.heading_sensitivity @ [1, 1j])
    shape = p.evidence.z[1:].shape
    return (
        np.ascontiguousarray(np.broadcast_to(bend, shape)),
        np.ascontiguousarray(np.broadcast_to(response.heading_retention, shape)),
    )


def settle(fit: Fit) -> Fit:
    """Effects and noise together at their maximum: in turns, until neither gains."""
    fit = with_noise(maximise(fit))
    for _ in range(ROUNDS):
        better = with_noise(maximise(fit))
        gain = fit.cost - better.cost
        if gain > 0:
            fit = better
        if gain < 0.1:
            return fit
    return fit
