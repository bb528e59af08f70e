"""Fit of one candidate effect: starting points, maximum, and its p-value.

Effects with a place, a width or a frequency have many local maxima. Where no effect is present,
the largest of them exceeds what χ² predicts. Such effects are scanned first, and their p-value is
corrected for every independent place tried (the look-elsewhere effect: Davies 1987, Gross and
Vitells 2010). Each effect defines its own scan (`Effect`, "Search for the effect").
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
"""Gain in −2 log likelihood per step below which a coarse fit ends.

Choice: the candidate is then ranked to about a unit; a smaller value costs steps for each.
"""

REACH = 20.0
"""Distance in log p behind the best coarse fit up to which a candidate is fitted to its maximum.

Choice: far more than a coarse fit errs by; a larger value costs fits of hopeless candidates.
"""


@dataclass(frozen=True)
class CandidateFit:
    """A fit with one effect more than another fit.

    Attributes
    ----------
    fit : ModelFit
        Fit with the effect.
    id : str
        Id of the effect.
    likelihood_ratio : float
        −2 log likelihood gained, with `dof` degrees of freedom.
    dof : int
        Degrees of freedom.
    trials : float
        Independent places at which the effect was tried.
    shape_seen : bool
        Whether the recording shows the shape that was found, not only its flank.
    price_of_turning : float
        Cost, in log odds, of a rotational diffusion that is fitted with the effect only.
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
        """Natural log of the p-value, corrected for the scan."""
        return log_of_any(log_chi_square_tail(self.likelihood_ratio, self.dof), self.trials)

    @property
    def p_value(self) -> float:
        """Probability of as much evidence where the effect is absent, corrected for the scan."""
        return float(np.exp(max(self.log_p, -700.0)))

    @property
    def delta_bic(self) -> float:
        """Decrease of the Bayesian information criterion: positive if worth its parameters."""
        return float(self.likelihood_ratio - self.dof * np.log(self.fit.count))


def compare(fit: ModelFit, rest: ModelFit, effect_id: str) -> CandidateFit:
    """Return what an effect contributes to a fit.

    Parameters
    ----------
    fit : ModelFit
        Fit with the effect.
    rest : ModelFit
        Fit without it.
    effect_id : str
        Id of the effect.

    Returns
    -------
    CandidateFit
        Likelihood ratio, degrees of freedom and trials.

    Raises
    ------
    ValueError
        If `fit` does not have the effect.
    """
    effect, evidence = fit.model.effect(effect_id), FitEvidence(fit)
    if effect is None:
        raise ValueError(f'the fit has no {effect_id}')
    return CandidateFit(
        fit, effect_id, rest.cost - fit.cost, effect.degrees_of_freedom(evidence),
        effect.trials(evidence), effect.shape_seen(evidence),
        fit.price_of_turning - rest.price_of_turning)


def fit_candidate(fit: ModelFit, effect_id: str) -> CandidateFit | None:
    """Fit a model with one more effect.

    Parameters
    ----------
    fit : ModelFit
        Fit without the effect.
    effect_id : str
        Id of the effect.

    Returns
    -------
    CandidateFit or None
        The best fit; None where the data cannot show the effect.
    """
    found = look_at(fit, effect_id)
    return found and polish(found, fit)


def look_at(fit: ModelFit, effect_id: str) -> CandidateFit | None:
    """Fit a model with one more effect coarsely, from the best of its starting points.

    Parameters
    ----------
    fit : ModelFit
        Fit without the effect.
    effect_id : str
        Id of the effect.

    Returns
    -------
    CandidateFit or None
        Accurate to about a unit of the likelihood ratio; None where the data cannot show the
        effect.
    """
    effect, evidence = EFFECTS[effect_id], FitEvidence(fit)
    if not effect.applies(evidence) or effect.absorbed_by_phi(evidence):
        return None
    tried = [maximise(fit.under(fit.model.with_effect(start)), enough=COARSE)
             for start in effect.starts(evidence)]
    return min((compare(one, fit, effect_id) for one in tried),
               key=lambda one: one.log_p, default=None)


def polish(found: CandidateFit, fit: ModelFit) -> CandidateFit:
    """Fit a coarse candidate to its maximum.

    The noise is refitted too if the likelihood ratio exceeds NEGLIGIBLE.

    Parameters
    ----------
    found : CandidateFit
        Coarse fit.
    fit : ModelFit
        Fit without the effect.

    Returns
    -------
    CandidateFit
        The maximum.
    """
    best = compare(maximise(found.fit), fit, found.id)
    if best.likelihood_ratio <= NEGLIGIBLE:
        return best
    return compare(fit_with_noise(best.fit), fit, found.id)


def search(fit: ModelFit, names: Iterable[str], run: Run = serially) -> list[CandidateFit]:
    """Fit each of several effects beside a fit.

    A candidate far behind the best coarse fit stays coarse, unless it gives headings a memory,
    since then it shows only with noise of its own.

    Parameters
    ----------
    fit : ModelFit
        Fit without these effects.
    names : iterable of str
        Ids of the effects.
    run : Run, optional
        `serially` or `in_processes`.

    Returns
    -------
    list of CandidateFit
        Every effect that the data can show, smallest p-value first.
    """
    kept = [one for p in fit.session_fits for one in (p.session, p.whitening)]
    seen = [one for one in run(partial(look_at, fit), list(names), kept) if one is not None]
    best = min((one.log_p for one in seen), default=0.0)
    near = [one.log_p < best + REACH or one.fit.model.lags != fit.model.lags for one in seen]
    polished = iter(run(partial(polish, fit=fit), list(compress(seen, near)), kept))
    found = [next(polished) if is_near else one for one, is_near in zip(seen, near, strict=True)]
    return sorted(found, key=lambda one: one.log_p)


def without(fit: ModelFit, name: str) -> ModelFit:
    """Remove an effect from a fit and maximise the rest again.

    Parameters
    ----------
    fit : ModelFit
        Fit with the effect.
    name : str
        Id of the effect.

    Returns
    -------
    ModelFit
        Fit without it.
    """
    return fit_with_noise(fit.under(fit.model.without(name)))


def contribution(fit: ModelFit, name: str) -> CandidateFit:
    """Return what an effect of a fit contributes beside the others.

    Parameters
    ----------
    fit : ModelFit
        Fit with the effect.
    name : str
        Id of the effect.

    Returns
    -------
    CandidateFit
        Likelihood ratio, degrees of freedom and trials.
    """
    return compare(fit, without(fit, name), name)
