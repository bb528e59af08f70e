"""What an effect may query about a fit: the implementation of `Evidence`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.discovery.check.tail_probabilities import peak_tail_probability
from microbot_ros.discovery.starting_points import (
    background,
    likely_places,
    rotating_components,
)
from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import SessionFit
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.model.effect import AnyEffect, Effect, Evidence, Recorded
from microbot_ros.model.model import Propulsion
from microbot_ros.session.tables.folder import NOMINAL_FIELD

COARSE = (0.3, 2.0, 10.0)
"""Fit coordinates, of both signs, at which an effect of one parameter is tried as a start.

Choice: the fit converges from within a factor of about 3; more starts cost one fit each.
"""

ABSORBED = 0.05
"""Fraction of an effect's information that must remain beside φ for the effect to be identifiable.

Choice: a smaller value fits effects that φ absorbs, a larger one excludes weak but visible ones.
"""

TRIED = 3
"""Number of starting points from which a full fit is made.

Choice: one fit more per effect for each; with fewer a local maximum may be returned.
"""

NEGLIGIBLE = 8.0
"""Likelihood ratio below which neither refitted noise nor another place can make an effect likely.

Choice: far below the ratio that names an effect; a larger value saves fits, and may miss some.
"""

CHANCE = 0.1
"""Probability of a peak in the noise around it from which on it is no line.

Choice: 0.004 was the largest of 51 true oscillations in simulated recordings. The evidence already
pays for all frequencies. A smaller value loses oscillations of few periods, which raise the noise
around themselves.
"""


@dataclass(frozen=True)
class FitEvidence(Evidence):
    """Recordings and residuals of a `fit`, as effects query them."""

    fit: ModelFit

    @property
    def propulsion(self) -> Propulsion:
        return self.fit.model.propulsion

    @property
    def recordings(self) -> Sequence[Recorded]:
        return [p.session.timeline for p in self.fit.session_fits]

    @property
    def duration(self) -> float:
        return max(float(np.ptp(p.session.times)) for p in self.fit.session_fits)

    @property
    def fastest(self) -> float:
        return min(3.0, 0.4 / max(p.session.interval for p in self.fit.session_fits))

    @property
    def frequencies(self) -> np.ndarray:
        return np.unique(np.concatenate([
            np.abs(p.session.commands.frequency_at(p.session.times))
            for p in self.fit.session_fits]))

    @property
    def strength_known(self) -> bool:
        return not all(_strength_unknown(p.session) for p in self.fit.session_fits)

    @property
    def has_neighbours(self) -> bool:
        return any(len(p.session.ids) > 1 for p in self.fit.session_fits)

    def absorbs(self, little: Effect, beside: Sequence[Effect] = ()) -> bool:
        # Otherwise other errors of the model would decide about the rest of its information.
        bare = ModelFit(replace(self.fit.model, effects=()), self.fit.session_fits)
        model = bare.model
        for effect in (*beside, little):
            model = model.with_effect(effect)
        tried = bare.under(model)
        own = np.array([name == little.id for name, _ in model.parameters])
        information = tried.normal[0]
        shared = information[np.ix_(own, ~own)]
        left = information[np.ix_(own, own)] - shared @ np.linalg.pinv(
            information[np.ix_(~own, ~own)], hermitian=True) @ shared.T
        power = sum(float((np.abs(jacobian[..., own]) ** 2).sum()) for jacobian in tried.jacobian)
        return bool(np.trace(left) < ABSORBED * power)

    def near_nothing(self, kind: type[AnyEffect]) -> Sequence[AnyEffect]:
        parameters = kind.parameters()
        small = {p.field: p.from_fit(min(1e-3, p.fit_bounds[1])) for p in parameters}
        starts = [kind(**small)]
        if len(parameters) > 1:
            return starts
        low, high = parameters[0].fit_bounds
        coarse = [kind(**{parameters[0].field: parameters[0].from_fit(x)})
                  for size in COARSE for x in (size, -size) if low <= x <= high]
        costs = [self.fit.under(self.fit.model.with_effect(start)).cost for start in coarse]
        best = int(np.argmin(costs))
        return [*starts, coarse[best]] if costs[best] < self.fit.cost + 20 else starts

    def swings(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the periodogram of the longest session's residuals, summed over particles."""
        return rotating_components(
            self._longest.session.times, self._longest.residual.sum(axis=1), self.fastest)

    def is_line(self, effect: Effect, frequency: float, direction: float) -> bool:
        rest = FitEvidence(self.fit.under(self.fit.model.without(effect.id)))._longest
        along = (rest.residual.sum(axis=1) * np.exp(-1j * direction)).real
        known, turned, _ = rotating_components(rest.session.times, along, self.fastest)
        power = 2 * np.abs(turned)**2 / rest.count
        above = float(np.interp(frequency, known, power / background(power, 2)))
        return peak_tail_probability(above, 2, self.fastest * self.duration) < CHANCE

    @property
    def _longest(self) -> SessionFit:
        return max(self.fit.session_fits, key=lambda p: float(np.ptp(p.session.times)))

    def likely(self, starts: Iterable[AnyEffect],
               near: Callable[[AnyEffect, AnyEffect], bool]) -> Sequence[AnyEffect]:
        return likely_places(self.fit, starts, near, TRIED)

    def promising(self, starts: Iterable[AnyEffect],
                  price: Callable[[AnyEffect], float] = lambda _: 0.0,
                  ) -> Sequence[AnyEffect]:
        """Return the starts of the largest score, less their `price`.

        At most TRIED: the best, and those above both NEGLIGIBLE and half of the best score.
        """
        scored = []
        for start in starts:
            score, suited = self._with_best_strength(start)
            scored.append((score - price(suited), suited))
        scored = sorted(scored, key=lambda one: -one[0])[:TRIED]
        best = max((score for score, _ in scored), default=0.0)
        return [start for score, start in scored
                if score == best or score > max(NEGLIGIBLE, best / 2)]

    def _with_best_strength(self, start: AnyEffect) -> tuple[float, AnyEffect]:
        """Return a start with its best strength, in which the drift is linear, after its score."""
        strength = next(p for p in start.parameters() if not p.shape)
        unit = replace(start, **{strength.field: strength.from_fit(1.0)})
        model = self.fit.model.with_effect(unit)
        information, slope = 1e-30, 0.0
        for p in self.fit.session_fits:
            expected = ExpectedDisplacement.of(model, p.session.timeline)
            moved = expected.at(p.velocity_phasor) - p.expected.at(p.velocity_phasor)
            column = p.whiten(np.broadcast_to(moved, p.session.z.shape)[..., None])[..., 0]
            information += float((np.abs(column) ** 2).sum())
            slope += float((column.conj() * p.residual).real.sum())
        low, high = strength.fit_bounds
        size = float(np.clip(slope / information, low, high))
        suited = replace(start, **{strength.field: strength.from_fit(size)})
        return slope**2 / information, suited

    def deviations(self, effect: Effect) -> Mapping[str, float]:
        std = np.sqrt(np.diag(self.fit.covariance))
        return {p.field: p.scale * s
                for (name, p), s in zip(self.fit.model.parameters, std, strict=True)
                if name == effect.id}


def _strength_unknown(session: PreparedSession) -> bool:
    """Return whether the recording of a rolling field has its direction only, not its strength."""
    if session.commands.frequency is None or session.conditions.reference_field:
        return False
    strength = np.hypot(*session.commands.field.T)
    return bool(np.allclose(strength[strength > 0], NOMINAL_FIELD, rtol=1e-6))
