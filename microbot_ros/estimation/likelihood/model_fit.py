"""Fit of a model to sessions: effects and the noise of every session at the maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.fluctuation import fit_fluctuation, fluctuating
from microbot_ros.estimation.likelihood.joint import (
    ENOUGH,
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
"""Maximum number of rounds in which effects and noise are fitted in turn.

Choice: a few suffice; it bounds the time where they converge slowly.
"""

SETTLED = 0.05
"""Relative change of an alignment time below which the rows that it explains hardly change.

Choice: a smaller value costs fits.
"""

SURE = 0.1
"""Fraction of ENOUGH by which a gain may differ from the predicted one for the step to be the
last.

Choice: the parabola then holds, and the next step would gain as little."""

NEGLIGIBLE = 1e-4
"""Predicted gain in −2 log likelihood for which no step is made.

Choice: 0.01 standard deviations of a parameter.
"""

TURNING = math.log(1e-5), math.log(10.0)
"""Logarithms of the bounds of rotational diffusion [rad²/s] where it is unknown.

Choice: spheres in water have these at radii of 25 and 0.25 µm.
"""

BEYOND = 10.0
"""Gain in −2 log likelihood, beyond the Bayesian information criterion, for speeds to fluctuate.

Choice: odds of 150. A smaller value slows searches of steady sessions.
"""

BY_CHANCE = 0.01
"""Probability per session of a cut where only noise is present.

Choice: cuts lose hardly any data.
"""

COLLINEAR = 1e-7
"""Fraction of a column's power below which v and φ absorb it. Choice: above rounding errors."""

NOTHING = 1e-30
"""Information on a parameter, in fit coordinates, that counts as none. Choice: avoids overflow."""


@dataclass(frozen=True)
class ModelFit:
    """Fit of a `model` to all sessions together: `session_fits`, each with its own noise."""

    model: Model
    session_fits: tuple[SessionFit, ...]

    @cached_property
    def log_likelihood(self) -> float:
        """Log likelihood of all sessions."""
        return sum(p.log_likelihood for p in self.session_fits)

    @property
    def cost(self) -> float:
        """−2 log likelihood."""
        return -2 * self.log_likelihood

    @cached_property
    def price_of_turning(self) -> float:
        """Cost in log odds of fitting the rotational diffusion D_r of sessions; 0 if known.

        The prior of log D_r is flat over TURNING, and the peak of the likelihood has a standard
        deviation s: log(range/(√(2π) s)).
        """
        return sum(map(_price_of_turning, self.session_fits))

    @property
    def count(self) -> int:
        """Number of measured coordinates: two for every row used."""
        return 2 * sum(p.count for p in self.session_fits)

    def under(self, model: Model) -> ModelFit:
        """Evaluate another model with the same noise on the same sessions.

        Parameters
        ----------
        model : Model
            The other model; its parameters are not fitted.

        Returns
        -------
        ModelFit
            With v, φ and D at their maximum.
        """
        return evaluate(model, [s.session for s in self.session_fits],
                        [s.whitening for s in self.session_fits])

    @cached_property
    def jacobian(self) -> tuple[np.ndarray, ...]:
        """Whitened derivatives (T, N, P) of the expected positions by fit coordinates, by session.

        At constant v and φ, in units of the noise.
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
        """Inner products (N, 3 + P, 3 + P) of data, v and φ, and parameters, by session."""
        from microbot_ros.estimation.likelihood.kernels import joint_products

        return tuple(
            joint_products(p.white, jacobian, 1 / math.sqrt(p.diffusion))
            for p, jacobian in zip(self.session_fits, self.jacobian, strict=True))

    def polars(self, held: int | None = None) -> list[Polar]:
        """Return speed and φ of the particles of every session.

        They include the uncertainty of the effects: v e^{iφ} follows their parameters by least
        squares.

        Parameters
        ----------
        held : int, optional
            Index of a parameter whose uncertainty is left out.

        Returns
        -------
        list of Polar
            One for each session, as by `SessionFit.polar`.
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
        """JᵀJ (P, P) and Jᵀr (P,) with v and φ eliminated, and which parameters remain visible."""
        total = np.zeros((1 + len(self.model.vector()),) * 2)
        raw = np.zeros(len(total))
        for gram in self._grams:
            total += eliminate(gram).sum(axis=0)
            raw[1:] += np.diagonal(gram, axis1=1, axis2=2)[:, 3:].sum(axis=0)
        visible = np.diag(total)[1:] > np.maximum(COLLINEAR * raw[1:], NOTHING)
        return total[1:, 1:], total[1:, 0], visible

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (P, P) of the effects' parameters in fit coordinates; infinite if unseen."""
        information, _, visible = self.normal
        result = np.diag(np.where(visible, 0.0, np.inf))
        if visible.any():
            chosen = np.ix_(visible, visible)
            result[chosen] = np.linalg.pinv(information[chosen], hermitian=True)
        # Rounding errors may make the variance of nearly collinear parameters negative.
        variance = np.diagonal(result)
        np.fill_diagonal(result, np.where(variance > 0, variance, np.inf))
        return result


def _derivative(fit: SessionFit, model: Model, step: float) -> np.ndarray:
    """Return the difference (T, N) [m] of a `model` that is a `step` away, over the step."""
    moved = ExpectedDisplacement.of(model, fit.session.timeline)
    return moved.beyond(fit.expected, fit.velocity_phasor) / step


def _constant(model: Model, name: str, parameter: Parameter) -> Hashable:
    """Return a key of what the derivative of a strength depends on; None if on too much.

    It depends on the shape of its effect, and on what field and camera do to it.
    """
    effect = model.effect(name)
    if effect is None or not effect.proportional or parameter.shape:
        return None
    shape = tuple(value for p, value in effect.values().items() if p.shape)
    around = tuple(one for one in model.effects if one.stage in ('field', 'observation'))
    return name, parameter.name, shape, around


def difference_steps(model: Model) -> np.ndarray:
    """Return the steps of difference quotients.

    Parameters
    ----------
    model : Model
        Model with P parameters.

    Returns
    -------
    ndarray, shape (P,)
        Steps in fit coordinates, away from upper bounds.
    """
    x = model.vector()
    high = np.array([p.fit_bounds[1] for _, p in model.parameters])
    step = 1e-5 * (1 + np.abs(x))
    return np.where(x + step <= high, step, -step)


def evaluate(model: Model, sessions: Sequence[PreparedSession],
             whitenings: Sequence[Whitening]) -> ModelFit:
    """Evaluate a model on sessions with known noise.

    Parameters
    ----------
    model : Model
        The model; its parameters are not fitted.
    sessions : sequence of PreparedSession
        The sessions.
    whitenings : sequence of Whitening
        Noise of each session.

    Returns
    -------
    ModelFit
        With v, φ and D at their maximum.
    """
    return ModelFit(model, tuple(
        SessionFit.of(session, whitening, ExpectedDisplacement.of(model, session.timeline))
        for session, whitening in zip(sessions, whitenings, strict=True)))


def maximise(fit: ModelFit, iterations: int = 20, held: int | None = None,
             enough: float = ENOUGH) -> ModelFit:
    """Maximise the likelihood over the effects' parameters, by Levenberg and Marquardt's method.

    Parameters stay within their bounds, and the noise filters as they are. The search ends when a
    step gains less than `enough`, or so nearly what the parabola predicted that as little remains.
    No step is made if the vertex is within bounds and gains less than NEGLIGIBLE.

    Parameters
    ----------
    fit : ModelFit
        Fit to start from.
    iterations : int, optional
        Maximum number of steps.
    held : int, optional
        Index of a parameter that stays constant.
    enough : float, optional
        Gain in −2 log likelihood that ends the search.

    Returns
    -------
    ModelFit
        The maximum.
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
    """Return one step downhill or None, the predicted gain, and the next damping.

    The step is doubled where that is better still: a Gauss–Newton step is too short where
    residuals are large and curved.
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
    # At a bound there may be a kink, which a parabola does not show.
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
    """Maximise the restricted likelihood over the noise of every session.

    Parameters
    ----------
    fit : ModelFit
        Fit of the model.
    near : bool, optional
        Whether the maximum is near the noise of `fit`, from which the search then climbs.

    Returns
    -------
    ModelFit
        The same model with new noise.
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


def unsteady(sessions: Sequence[PreparedSession], fit: ModelFit,
             best: ModelFit) -> tuple[list[PreparedSession], float] | None:
    """Return sessions whose noise includes fluctuating speeds, where the data support it.

    By the restricted likelihood, with a cost of log n for each parameter of the noise and BEYOND
    for all. The gain is over the better of both fits. Tracks are cut at the few steps that are
    outliers then.

    Parameters
    ----------
    sessions : sequence of PreparedSession
        The sessions.
    fit : ModelFit
        Fit without effects that give headings a memory.
    best : ModelFit
        Best fit of steady speeds, whose headings may have a memory.

    Returns
    -------
    (list of PreparedSession, float) or None
        The sessions, and the log evidence for the fluctuations, less their cost; None if all
        speeds are steady.
    """
    numbers = 6 if fit.model.propulsion == 'rolling' else 5
    restless, evidence = [], 0.0
    for session, p, other in zip(sessions, fit.session_fits, best.session_fits, strict=True):
        one = session
        if not (session.speeds_fluctuate or remembers(fit.model, session)):
            least = max(p.restricted_log_likelihood, other.restricted_log_likelihood)
            found = fit_fluctuation(p, fit.model)
            gain = 2 * (found.restricted_log_likelihood - least)
            paid = gain - numbers * math.log(2 * p.count) - BEYOND
            if paid > 0:
                out = np.zeros_like(session.seen)
                out[np.isin(session.times, p.session.times)] = np.abs(found.residual) ** 2 > (
                    2 * math.log(found.count / BY_CHANCE))
                one = replace(session, speeds_fluctuate=True).cut_at(out)
                evidence += paid / 2
        restless.append(one)
    return (restless, evidence) if evidence else None


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
    """Return the last value of a search."""
    *_, found = search
    assert found is not None
    return found


def remembers(model: Model, session: PreparedSession) -> bool:
    """Return whether noise of a heading persists to the next frame.

    It does under a lag, and while a session of swimmers has no field.

    Parameters
    ----------
    model : Model
        The model.
    session : PreparedSession
        The session.

    Returns
    -------
    bool
        Whether the noise filter needs the heading.
    """
    if model.lags:
        return True
    if model.propulsion == 'rolling':  # does not move then
        return False
    on = np.hypot(*session.commands.field.T) > 0
    later = session.commands.t > session.times[0]
    return not on[later].all()


def whitening_on(model: Model, known: SessionFit, session: PreparedSession) -> Whitening:
    """Return the noise of a fit for another session of the same particles.

    Parameters
    ----------
    model : Model
        Model of the fit.
    known : SessionFit
        The fit.
    session : PreparedSession
        The other session.

    Returns
    -------
    Whitening
        The noise.
    """
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
    """Return sensitivity and retention of headings (T − 1, N) in every frame interval."""
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
    """Maximise the likelihood over effects and noise together, in turns.

    The noise is searched near that of the fit, except where headings have a memory now and had
    none.

    Parameters
    ----------
    fit : ModelFit
        Fit to start from.

    Returns
    -------
    ModelFit
        The maximum.
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
    """Fit a model to the rows of sessions that it can explain.

    Positions that effects depend on are those of a filter under the model.

    Parameters
    ----------
    model : Model
        Model whose parameters the fit starts from.
    sessions : sequence of PreparedSession
        The sessions.

    Returns
    -------
    ModelFit
        The maximum.
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
    """Fit a `model` to the rows that it can explain, before and after the fit."""
    fit = _fit_predictable(model, sessions, [ROTATIONAL_DIFFUSION] * len(sessions))
    if fit.model.lags:
        # The rows that a lag can explain also depend on the noise of headings.
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
    """Fit a `model` at raw positions, with headings that diffuse by `turning` [rad²/s].

    Without learned terms: these may need φ, which is not known yet.
    """
    parts = [predictable_part(session, model, one)
             for session, one in zip(sessions, turning, strict=True)]
    start = evaluate(
        replace(model, learned=()), parts, [Whitening(part.interval) for part in parts])
    return fit_with_noise(fit_noise(start))
