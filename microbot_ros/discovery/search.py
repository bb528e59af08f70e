"""One candidate at a time: where its fit may begin, its maximum, and how likely that is by chance.

Effects with a place, a width or a frequency have many local maxima, and where nothing is hidden
the largest of them is larger than χ² says: they are scanned first, and pay for every independent
place they were looked for at (the look-elsewhere effect: Davies 1987, Gross and Vitells 2010).
What is peculiar to an effect it says itself (`Effect`, "How it is looked for").
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import compress

import numpy as np

from microbot_ros.discovery.check.tail_probabilities import log_chi_square_tail, log_of_any
from microbot_ros.discovery.evidence import NEGLIGIBLE, FitEvidence
from microbot_ros.discovery.processes import Run, serially
from microbot_ros.estimation.likelihood.model_fit import ModelFit, fit_with_noise, maximise
from microbot_ros.model.effects import EFFECTS

COARSE = 0.5
"""Gain in −2 log likelihood that ends a first look at a candidate."""

REACH = 20.0
"""How far a candidate's log p may lie behind the best at first sight and still be polished."""


@dataclass(frozen=True)
class CandidateFit:
    """A `fit` with the effect `id` more, beside one without it.

    `likelihood_ratio` LR with `dof` degrees of freedom; `trials`: independent places at which the
    effect was looked for; `shape_seen`: whether the recording shows the shape that was found, not
    only its flank; `price_of_turning`: what a rotational diffusion costs, in log odds, that is
    fitted with the effect and not without it.
    """

    fit: ModelFit
    id: str
    likelihood_ratio: float
    dof: int
    trials: float
    shape_seen: bool
    price_of_turning: float = 0.0

    @property
    def has_shape(self) -> bool:
        """Whether the effect has a place, a width or a frequency to be found."""
        return any(p.shape for p in EFFECTS[self.id].parameters())

    @property
    def log_p(self) -> float:
        """Logarithm of the chance of so much evidence where nothing is there, scan included."""
        return log_of_any(log_chi_square_tail(self.likelihood_ratio, self.dof), self.trials)

    @property
    def p_value(self) -> float:
        """The chance itself."""
        return float(np.exp(max(self.log_p, -700.0)))

    @property
    def delta_bic(self) -> float:
        """Positive where the effect is worth its parameters."""
        return float(self.likelihood_ratio - self.dof * np.log(self.fit.count))


def compare(fit: ModelFit, rest: ModelFit, effect_id: str) -> CandidateFit:
    """What the effect `effect_id` of a `fit` brings beside the `rest`, the fit without it."""
    effect, evidence = fit.model.effect(effect_id), FitEvidence(fit)
    if effect is None:
        raise ValueError(f'the fit has no {effect_id}')
    return CandidateFit(
        fit, effect_id, rest.cost - fit.cost, effect.degrees_of_freedom(evidence),
        effect.trials(evidence), effect.shape_seen(evidence),
        fit.price_of_turning - rest.price_of_turning)


def fit_candidate(fit: ModelFit, effect_id: str) -> CandidateFit | None:
    """The best fit of a model with `effect_id` added to that of a `fit`.

    None where the data can't show it.
    """
    found = look_at(fit, effect_id)
    return found and polish(found, fit)


def look_at(fit: ModelFit, effect_id: str) -> CandidateFit | None:
    """A coarse fit of a model with `effect_id` added to that of a `fit`, from the best start.

    Good to about a unit of the likelihood ratio. None where the data can't show the effect.
    """
    effect, evidence = EFFECTS[effect_id], FitEvidence(fit)
    if not effect.applies(evidence) or effect.absorbed_by_phi(evidence):
        return None
    tried = [maximise(fit.under(fit.model.with_effect(start)), enough=COARSE)
             for start in effect.starts(evidence)]
    return min((compare(one, fit, effect_id) for one in tried),
               key=lambda one: one.log_p, default=None)


def polish(found: CandidateFit, fit: ModelFit) -> CandidateFit:
    """A coarse candidate `found` beside a `fit` at its maximum; with noise, if it is evidence."""
    best = compare(maximise(found.fit), fit, found.id)
    if best.likelihood_ratio <= NEGLIGIBLE:
        return best
    return compare(fit_with_noise(best.fit), fit, found.id)


def search(fit: ModelFit, names: Iterable[str], run: Run = serially) -> list[CandidateFit]:
    """Every candidate among `names` that the data can show beside a `fit`, best first.

    The least likely by chance. What at first sight lies far behind the best stays as it is then,
    unless it makes headings remember, since then it shows with noise of its own. `run` as
    `serially` or `in_processes`.
    """
    kept = [one for p in fit.session_fits for one in (p.session, p.whitening)]
    seen = [one for one in run(partial(look_at, fit), list(names), kept) if one is not None]
    best = min((one.log_p for one in seen), default=0.0)
    near = [one.log_p < best + REACH or one.fit.model.lags != fit.model.lags for one in seen]
    polished = iter(run(partial(polish, fit=fit), list(compress(seen, near)), kept))
    found = [next(polished) if is_near else one for one, is_near in zip(seen, near, strict=True)]
    return sorted(found, key=lambda one: one.log_p)


def without(fit: ModelFit, name: str) -> ModelFit:
    """A `fit` with the effect `name` less, all else at its maximum again."""
    return fit_with_noise(fit.under(fit.model.without(name)))


def contribution(fit: ModelFit, name: str) -> CandidateFit:
    """What the effect `name` of a `fit` brings beside the others."""
    return compare(fit, without(fit, name), name)
