"""A model on sessions: its effects and every session's noise at the maximum of the likelihood."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import (
    LARGEST,
    SMALLEST,
    SessionFit,
    Whitening,
    climb,
    eliminate,
    search_noise_ratio,
    solve,
)
from microbot_ros.estimation.likelihood.phasor import Polar
from microbot_ros.estimation.likelihood.prepared_session import (
    ROTATIONAL_DIFFUSION,
    PreparedSession,
    predictable_part,
)
from microbot_ros.model.increments import heading_response
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.parameter import Parameter

ROUNDS = 8
"""Turns in which effects and noise are fitted, at most."""

SETTLED = 0.05
"""Relative change of an alignment time with which the rows that it can explain hardly change."""

ENOUGH = 0.01
"""Gain in −2 log likelihood that ends a search: a tenth of a standard deviation is left."""

SURE = 0.1
"""Part of what is enough by which a gain may differ from the one foretold, to be the last."""

NEGLIGIBLE = 1e-4
"""Gain in −2 log likelihood that no step is tried for: a hundredth of a standard deviation."""

TURNING = math.log(1e-5), math.log(10.0)
"""Between what rotational diffusion [rad²/s] is looked for where nothing tells it, logarithms."""

SHORTEST, LONGEST, PART = 2.0, 5.0, 0.05
"""Between what the correlation time of speeds is looked for: so many frame intervals, seconds [s],
and no more than this part of the recording. What lasts longer is a trend, which has other names.
"""

LEAST = 0.01
"""Strength of a fluctuation that is none: a share of the speed, or of a frame interval [s]; and of
the wander over it, or of a swing. A choice: with half or twice of it nothing changes by 0.1."""

WIDEST = 1e9
"""Largest over smallest variance of a kind of noise: far beyond what is found."""

STARTS = 0.2, 2.0
"""Correlation times [s] from which it is looked for."""

BEYOND = 10.0
"""Gain in −2 log likelihood, over that of the Bayesian information criterion, from which speeds
are said to fluctuate: odds of 150."""

BY_CHANCE = 0.01
"""Chance per session of a cut where nothing but noise is."""

MOVES = 1e-12
"""Displacement between frames [m] that is none."""

COLLINEAR = 1e-7
"""Part of a column's power below which v and φ absorb it."""

NOTHING = 1e-30
"""Information about a parameter, in fit coordinates, that is none."""


@dataclass(frozen=True)
class ModelFit:
    """A `model` on all sessions together: `session_fits`, each with its own noise."""

    model: Model
    session_fits: tuple[SessionFit, ...]

    @cached_property
    def log_likelihood(self) -> float:
        """Of all sessions."""
        return sum(p.log_likelihood for p in self.session_fits)

    @property
    def cost(self) -> float:
        """−2 log likelihood."""
        return -2 * self.log_likelihood

    @cached_property
    def price_of_turning(self) -> float:
        """What fitting the rotational diffusion D_r of sessions costs, in log odds.

        0 where it is known. The prior of log D_r is flat over TURNING, and the peak of the
        likelihood has a standard deviation s: log(range/(√(2π) s)).
        """
        return sum(map(_price_of_turning, self.session_fits))

    @property
    def count(self) -> int:
        """Numbers that were measured: two for every row used."""
        return 2 * sum(p.count for p in self.session_fits)

    def under(self, model: Model) -> ModelFit:
        """Another `model` with the same noise on the same sessions; nothing is searched."""
        return evaluate(model, [s.session for s in self.session_fits],
                        [s.whitening for s in self.session_fits])

    @cached_property
    def jacobian(self) -> tuple[np.ndarray, ...]:
        """For each session, white derivatives (T, N, P) of what is expected, in fit coordinates.

        At fixed v and φ, in units of the noise.
        """
        steps = difference_steps(self.model)
        x = self.model.vector()
        changed = [self.model.with_vector(x + step * unit)
                   for step, unit in zip(steps, np.eye(len(x)), strict=True)]
        keys = [_constant(self.model, *of) for of in self.model.parameters]
        white = []
        for p in self.session_fits:
            columns = p.white_columns([
                (key, partial(_derivative, p, model, step))
                for model, step, key in zip(changed, steps, keys, strict=True)])
            columns /= np.sqrt(p.diffusion)
            white.append(columns)
        return tuple(white)

    @cached_property
    def _grams(self) -> tuple[np.ndarray, ...]:
        """For each session, inner products (N, 3 + P, 3 + P) of data, v and φ, parameters."""
        from microbot_ros.estimation.likelihood.kernels import joint_products

        return tuple(
            joint_products(p.white, jacobian, 1 / math.sqrt(p.diffusion))
            for p, jacobian in zip(self.session_fits, self.jacobian, strict=True))

    def polars(self, held: int | None = None) -> list[Polar]:
        """Speed and φ of the particles of every session, as `SessionFit.polar` has them.

        With what is not known of the effects: v e^{iφ} follows their parameters as least squares
        has it. All but one that is `held`, by its place in the vector.
        """
        free = self.normal[2] & (np.arange(len(self.normal[2])) != held)
        covariance = np.linalg.pinv(self.normal[0][np.ix_(free, free)], hermitian=True)
        result = []
        for p, gram in zip(self.session_fits, self._grams, strict=True):
            followed = solve(gram[:, 1:3, 1:3], gram[:, 1:3, 3:][..., free])
            phasor = np.where(p.velocity_phasor == 0, np.nan, p.velocity_phasor)
            moved = (followed[:, 0] + 1j * followed[:, 1]) / phasor[:, None]
            real, imag = (np.einsum('np,pq,nq->n', part, covariance, part)
                          for part in (moved.real, moved.imag))
            result.append(p.polar().widened(np.sqrt(real) + 1j * np.sqrt(imag)))
        return result

    @cached_property
    def normal(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """JᵀJ (P, P), Jᵀr (P,) with v and φ taken out, and which parameters they leave visible."""
        total = np.zeros((1 + len(self.model.vector()),) * 2)
        raw = np.zeros(len(total))
        for gram in self._grams:
            total += eliminate(gram).sum(axis=0)
            raw[1:] += np.diagonal(gram, axis1=1, axis2=2)[:, 3:].sum(axis=0)
        visible = np.diag(total)[1:] > np.maximum(COLLINEAR * raw[1:], NOTHING)
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


def _derivative(fit: SessionFit, model: Model, step: float) -> np.ndarray:
    """What a `model` that is a `step` away moves the tracks further than that of a `fit`.

    (T, N) [m], by the step.
    """
    moved = ExpectedDisplacement.of(model, fit.session.timeline)
    return moved.beyond(fit.expected, fit.velocity_phasor) / step


def _constant(model: Model, name: str, parameter: Parameter) -> Hashable:
    """What the derivative of a strength depends on, if only on little; None if on more.

    On the shape of its effect, and on what the field and the camera do to it.
    """
    effect = model.effect(name)
    if effect is None or not effect.proportional or parameter.shape:
        return None
    shape = tuple(value for p, value in effect.values().items() if p.shape)
    around = tuple(one for one in model.effects if one.stage in ('field', 'observation'))
    return name, parameter.name, shape, around


def difference_steps(model: Model) -> np.ndarray:
    """Steps of the difference quotients, away from the upper bounds."""
    x = model.vector()
    high = np.array([p.fit_bounds[1] for _, p in model.parameters])
    step = 1e-5 * (1 + np.abs(x))
    return np.where(x + step <= high, step, -step)


def evaluate(model: Model, sessions: Sequence[PreparedSession],
             whitenings: Sequence[Whitening]) -> ModelFit:
    """A `model` with its parameters as they are on `sessions` with known `whitenings`."""
    return ModelFit(model, tuple(
        SessionFit.of(session, whitening, ExpectedDisplacement.of(model, session.timeline))
        for session, whitening in zip(sessions, whitenings, strict=True)))


def maximise(fit: ModelFit, iterations: int = 20, held: int | None = None,
             enough: float = ENOUGH) -> ModelFit:
    """Improve a `fit` in its effects' parameters, by Levenberg and Marquardt's method.

    Within their bounds, in at most that many `iterations`, until one gains less than `enough` in
    −2 log likelihood, or so much of what the parabola foretold, so that as little is left. Where
    its vertex is within bounds and gains less than is NEGLIGIBLE, nothing is tried. The noise
    filters stay as they are, and so does the parameter `held`, by its place in the vector.
    """
    if not fit.model.effects:
        return fit
    low, high = np.array([p.fit_bounds for _, p in fit.model.parameters]).T
    angle = np.array([p.is_angle for _, p in fit.model.parameters])
    low, high = np.where(angle, -np.inf, low), np.where(angle, np.inf, high)
    if held is not None:
        low[held] = high[held] = fit.model.vector()[held]
    damping = 1e-3
    for _ in range(iterations):
        better, foretold, damping = _improve(fit, low, high, angle, damping)
        if better is None:
            return fit
        gain, fit = fit.cost - better.cost, better
        if gain < enough or abs(gain - foretold) < SURE * enough:
            return fit
    return fit


def _improve(fit: ModelFit, low: np.ndarray, high: np.ndarray, angle: np.ndarray,
             damping: float) -> tuple[ModelFit | None, float, float]:
    """One step downhill, or None; the gain foretold; and the damping to go on with.

    Twice as far where that is better still: Gauss and Newton's step falls short where what is
    left is large and bent.
    """
    information, slope, visible = fit.normal
    x = fit.model.vector()
    free = visible & (low < high) & ~((x <= low) & (slope < 0)) & ~((x >= high) & (slope > 0))
    if not free.any():
        return None, 0.0, damping
    chosen = np.ix_(free, free)

    def foretold(step: np.ndarray) -> float:
        moved = np.clip(x + step, low, high) - x
        return float(2 * slope @ moved - moved @ information @ moved)

    def stepped(step: np.ndarray) -> ModelFit:
        there = np.clip(x + step, low, high)
        there[angle] = (there[angle] + np.pi) % (2 * np.pi) - np.pi
        return fit.under(fit.model.with_vector(there))

    step = np.zeros(len(x))
    step[free] = np.linalg.lstsq(information[chosen], slope[free], rcond=1e-14)[0]
    # At a bound there may be a kink, which no parabola tells of.
    inside = ((x + step > low) & (x + step < high)).all()
    if inside and foretold(step) < NEGLIGIBLE:
        return None, 0.0, damping
    for _ in range(8):
        damped = information[chosen] + damping * np.diag(np.diag(information)[free])
        step[free] = np.linalg.lstsq(damped, slope[free], rcond=1e-14)[0]
        tried = stepped(step)
        if tried.cost < fit.cost:
            gain = foretold(step)
            if abs(fit.cost - tried.cost - gain) > ENOUGH:
                further = stepped(2 * step)
                if further.cost < tried.cost:
                    tried, gain = further, foretold(2 * step)
            return tried, gain, damping / 5
        damping *= 8
    return None, 0.0, damping


def fit_noise(fit: ModelFit, near: bool = False) -> ModelFit:
    """The model of a `fit` with every session's noise at its maximum.

    Looked for everywhere, or uphill from what the fit has, where that was fitted to about the
    same: `near` it.
    """
    return ModelFit(
        fit.model, tuple(_fit_noise(fit.model, one, near) for one in fit.session_fits))


def _fit_noise(model: Model, fit: SessionFit, near: bool) -> SessionFit:
    session, known = fit.session, fit.whitening
    remembered = remembers(model, session)
    if session.speeds_fluctuate and not remembered:
        return fit_fluctuation(fit, model)
    near = near and remembered == (known.sensitivity is not None)
    plain = Whitening(known.noise_ratio, stretch=model.stretch)
    if remembered:
        sensitivity, retention = _heading_noise(model, session, fit.velocity_phasor)
        plain = replace(plain, sensitivity=sensitivity, retention=retention)

    def at(turning: float) -> SessionFit:
        return SessionFit.of(
            session, replace(plain, diffusion_ratio=turning / fit.diffusion), fit.expected)

    turning = session.rotational_diffusion if remembered else 0.0
    if turning is None:
        usual = math.log(known.diffusion_ratio * fit.diffusion) if near else None
        start = _last(climb(lambda u: at(math.exp(u)), *TURNING, usual))
    else:
        start = at(turning)
    return _last(search_noise_ratio(start, near))


def fluctuating(fit: SessionFit, time: float) -> Whitening:
    """The noise of a `fit` where velocities have deviations of correlation time `time` [s]."""
    interval = np.diff(fit.session.times)[:, None]
    moved = fit.moved
    retention = np.exp(-interval / time)
    # A deviation at the start of an interval acts for as long as it lasts.
    sensitivity = moved * (1 - retention) * time / interval
    length = np.abs(moved)
    way = np.where(length > MOVES, moved / np.maximum(length, MOVES), 0)
    velocity = np.pad(moved / interval, ((1, 1), (0, 0)), mode='edge')
    # A change within one interval shows in three, by a half, all and a half of it: 3/2 in all.
    change = np.abs(velocity[2:] - velocity[:-2]) ** 2 / 1.5
    return replace(
        fit.whitening, fluctuation=time, sensitivity=np.ascontiguousarray(sensitivity),
        retention=np.ascontiguousarray(np.broadcast_to(retention, sensitivity.shape)),
        way=np.concatenate([way[:1], way]), change=change, stride=way * np.sqrt(length))


def unsteady(sessions: Sequence[PreparedSession], fit: ModelFit,
             best: ModelFit) -> list[PreparedSession] | None:
    """The `sessions` of a `fit` with speeds that fluctuate in their noise; None if all are steady.

    By the restricted likelihood, a number of the noise for log n each and BEYOND them; also
    beside that of the `best` fit of steady speeds, whose headings may remember. Tracks are cut at
    the few steps that stand out then.
    """
    numbers = 6 if fit.model.propulsion == 'rolling' else 5
    restless, fluctuates = [], False
    for session, p, other in zip(sessions, fit.session_fits, best.session_fits, strict=True):
        one = session
        if not (session.speeds_fluctuate or remembers(fit.model, session)):
            least = max(p.restricted_log_likelihood, other.restricted_log_likelihood)
            found = fit_fluctuation(p, fit.model)
            gain = 2 * (found.restricted_log_likelihood - least)
            if gain > numbers * math.log(2 * p.count) + BEYOND:
                out = np.zeros_like(session.seen)
                out[np.isin(session.times, p.session.times)] = np.abs(found.residual) ** 2 > (
                    2 * math.log(found.count / BY_CHANCE))
                one = replace(session, speeds_fluctuate=True).cut_at(out)
                fluctuates = True
        restless.append(one)
    return restless if fluctuates else None


def fit_fluctuation(fit: SessionFit, model: Model) -> SessionFit:
    """A `fit` of a `model` with the noise of velocities that fluctuate at its maximum.

    With that of commands that act early or late, of the swing of rollers, and all other noise.
    Uphill from what the fit has, or from a few correlation times where its velocities are steady.
    """
    from scipy.optimize import minimize

    session, known = fit.session, fit.whitening
    h, rolls = session.interval, model.propulsion == 'rolling'
    longest = min(LONGEST, PART * float(np.ptp(session.times)))
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

    def at(u: np.ndarray) -> SessionFit:
        around, speed, time, wander, jitter, uneven, *swing = np.exp(u).tolist()
        noise = replace(
            fluctuating(fit, time), stretch=model.stretch, noise_ratio=around - h / 3,
            diffusion_ratio=speed, wander=wander, jitter_ratio=jitter, uneven_ratio=uneven,
            swing_ratio=swing[0] if rolls else 0.0)
        return SessionFit.of(session, noise, fit.expected)

    bounds = list(zip(low[:count], high[:count], strict=True))
    begun = [np.clip(np.log(np.maximum(of, 1e-300)), low, high)[:count] for of in starts]
    begin = max(begun, key=lambda u: at(u).restricted_log_likelihood)
    scale = abs(at(begin).restricted_log_likelihood)
    best = minimize(lambda u: -at(u).restricted_log_likelihood, begin, method='L-BFGS-B',
                    bounds=bounds, options={'eps': 1e-3, 'ftol': ENOUGH / scale, 'gtol': 0.1})
    return at(best.x)


def _price_of_turning(fit: SessionFit) -> float:
    known = fit.whitening
    if (known.sensitivity is None or known.fluctuation is not None
            or fit.session.rotational_diffusion is not None):
        return 0.0
    around = [replace(known, diffusion_ratio=known.diffusion_ratio * math.exp(step))
              for step in (-1.0, 1.0)]
    lower, upper = (SessionFit.of(fit.session, one, fit.expected).log_likelihood for one in around)
    curvature = 2 * fit.log_likelihood - lower - upper
    spread = math.sqrt(2 * math.pi / max(curvature, NOTHING))
    return max(math.log((TURNING[1] - TURNING[0]) / spread), 0.0)


def _last(search: Iterator[SessionFit | None]) -> SessionFit:
    """What a search ends with."""
    *_, found = search
    assert found is not None
    return found


def remembers(model: Model, session: PreparedSession) -> bool:
    """Whether under a `model` what noise does to a heading is still there at the next frame.

    As under a lag, and while a `session` has no field.
    """
    if model.lags:
        return True
    if model.propulsion == 'rolling':  # does not move then
        return False
    on = np.hypot(*session.commands.field.T) > 0
    later = session.commands.t > session.times[0]
    return not on[later].all()


def whitening_on(model: Model, known: SessionFit, session: PreparedSession) -> Whitening:
    """The noise of a `known` fit of a `model`, for another `session` of the same particles."""
    if known.whitening.fluctuation is not None:
        expected = ExpectedDisplacement.of(model, session.timeline)
        return fluctuating(replace(known, session=session, expected=expected),
                           known.whitening.fluctuation)
    if known.whitening.sensitivity is None:
        return known.whitening
    sensitivity, retention = _heading_noise(model, session, known.velocity_phasor)
    return replace(known.whitening, sensitivity=sensitivity, retention=retention)


def _heading_noise(model: Model, session: PreparedSession,
                   velocity_phasor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sensitivity and retention of headings over every frame interval: (T−1, N) each."""
    particles = ParticleParameters.from_velocity_phasor(session.ids, velocity_phasor)
    response = heading_response(model, particles, session.timeline)
    x, y = np.moveaxis(response.heading_sensitivity, -1, 0)
    sensitivity = np.nan_to_num(x + 1j * y)
    shape = session.z[1:].shape
    return (
        np.ascontiguousarray(np.broadcast_to(sensitivity, shape)),
        np.ascontiguousarray(np.broadcast_to(response.heading_retention, shape)),
    )


def fit_with_noise(fit: ModelFit) -> ModelFit:
    """Effects and noise together at their maximum, from a `fit`: in turns, until neither gains.

    Noise is taken to be near that of the fit, but where headings remember it that did not.
    """
    lags = fit.model.lags
    fit = fit_noise(fit if lags else maximise(fit), near=True)
    for _ in range(ROUNDS):
        better = fit_noise(maximise(fit), near=True)
        if lags and better.cost > fit.cost:
            # Filters that are right for one lag may favour another, which has other ones.
            better = fit_noise(maximise(fit, 1), near=True)
        gain = fit.cost - better.cost
        if gain > 0:
            fit = better
        if gain < 0.1:
            return fit
    return fit


def fit_sessions(model: Model, sessions: Sequence[PreparedSession]) -> ModelFit:
    """A `model` fitted to what of prepared `sessions` it can explain.

    Effects start from where the model has them. Positions that terms depend on are those that a
    filter under the model believes.
    """
    fit = _fit_sessions(model, sessions)
    for _ in range(ROUNDS):
        # Which rows a lag can explain depends on how long it is.
        before, now = model.alignment_time, fit.model.alignment_time
        if abs(now - before) <= SETTLED * now:
            break
        model, fit = fit.model, _fit_sessions(fit.model, sessions)
    return fit


def _fit_sessions(model: Model, sessions: Sequence[PreparedSession]) -> ModelFit:
    """Fit a `model` to the rows of `sessions` that it can explain, as it was and as it is then."""
    fit = _fit_predictable(model, sessions, [ROTATIONAL_DIFFUSION] * len(sessions))
    if fit.model.lags:
        # What a lag can explain depends on how noisy headings are, too.
        fit = _fit_predictable(fit.model, sessions, [
            s.whitening.diffusion_ratio * s.diffusion for s in fit.session_fits])
    located = [
        replace(s.session.with_filtered_positions(
            s.expected.at(s.velocity_phasor), s.whitening.noise_ratio),
            phi=np.angle(s.velocity_phasor)) for s in fit.session_fits]
    return fit_with_noise(evaluate(replace(fit.model, learned=model.learned), located,
                                   [s.whitening for s in fit.session_fits]))


def _fit_predictable(model: Model, sessions: Sequence[PreparedSession],
                     turning: Sequence[float]) -> ModelFit:
    """A `model` at the positions as they are, whose headings diffuse by `turning` [rad²/s].

    Without terms that were learned: they may ask for φ, which nobody knows yet.
    """
    parts = [predictable_part(session, model, one)
             for session, one in zip(sessions, turning, strict=True)]
    start = evaluate(
        replace(model, learned=()), parts, [Whitening(part.interval) for part in parts])
    return fit_with_noise(fit_noise(start))
