"""What is asked and when it ends by the rules of the literature, on the same worlds and fits.

- Box and Hill (Technometrics 9, 57, 1967): what makes the expected divergence between models,
  weighted by the probabilities π of both, largest; takes one that has a π of 0.999. Predictive
  densities, and with them π, are those of our own Bayes factors.
- Buzzi-Ferraris and Forzatti (Chem. Eng. Sci. 38, 225, 1983): what sets that pair of models
  furthest apart that it sets apart at all, models that χ² refuses left out; takes the last one.
- Michalik, Stuckert and Marquardt (Ind. Eng. Chem. Res. 49, 913, 2010): what makes the Akaike
  weight largest that the right model is expected to have then; takes one that has 0.999.

Olofsson and others (GPdoemd, Comput. Chem. Eng. 125, 54, 2019) measured the three. Plans are of
the kinds that ours are chosen from, and pay as ours for particles astray or touching. Models are
no effect and one of each, fitted to all that was seen; there is no price for looking again, and
none for what is in no list. Each goes on after it would have taken a model, so that it can be seen
when it would have, had it asked for more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import softmax
from scipy.stats import chi2

from bench._driven_rig import SimulatedRig
from microbot_ros.discovery.driven.design import (
    IMPROVED,
    PROPOSED,
    RANDOM,
    Question,
    Range,
    Search,
    _change,
    _draw,
    _Trial,
    random_steps,
)
from microbot_ros.discovery.driven.drive import BRIEF, SHORTEST, THOUGHT, lasting
from microbot_ros.discovery.driven.joined import join
from microbot_ros.discovery.driven.plan import Plan
from microbot_ros.discovery.hypotheses import log_bayes_factor
from microbot_ros.discovery.search import CandidateFit, search
from microbot_ros.estimation.likelihood.model_fit import ModelFit, fit_sessions
from microbot_ros.estimation.likelihood.prepared_session import prepare
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

DECIDED = 0.999
"""Weight at which a model is taken."""

CERTAIN = 50.0
"""How sure it is of a model [log odds] when it need not go on."""

REFUSED = 0.01
"""Chance of a χ² as large, below which a model is left out."""

ASKED = 5
"""The likeliest models, between which divergence is counted."""

Weigh = Callable[[Sequence[CandidateFit]], np.ndarray]
Sure = Callable[[Sequence[CandidateFit]], float]
Worth = Callable[[np.ndarray, np.ndarray], float]


@dataclass(frozen=True)
class Rule:
    """`weigh` (M,) no effect and those found; `worth` of a plan by weights and divergences.

    Divergences (M, M), by how much log likelihood it is expected to set two models further apart.
    `sure`: the log odds of the best model against all others, which is taken above `decided`.
    """

    weigh: Weigh
    sure: Sure
    decided: float
    worth: Worth


@dataclass(frozen=True)
class Said:
    """The `name` of the best model at a look, '' for none, after `seconds`, and how `sure` it is.
    """

    seconds: float
    name: str
    sure: float


def by_rule(rule: Rule, rig: SimulatedRig, minutes: float, seed: int) -> list[Said]:
    """Drive a `rig` by a `rule` for as many `minutes` at most; `seed` draws the plans."""
    rng, sessions, said = np.random.default_rng(seed), [], list[Said]()
    plan = random_steps(rng, BRIEF, rig.limits)
    while True:
        sessions.append(rig.play(plan).session)
        session = prepare(join(sessions))
        plain = fit_sessions(Model.baseline(session.conditions, session.commands), [session])
        found = search(plain, EFFECTS)
        weights = rule.weigh(found)
        best = int(np.argmax(weights))
        said.append(Said(rig.seconds, found[best - 1].id if best else '', rule.sure(found)))
        left = 60 * minutes - rig.seconds
        if left < SHORTEST or said[-1].sure > CERTAIN:
            return said
        trial, shares = _trial([plain, *(c.fit for c in found)], weights, rig.limits)
        plan = _most_telling(lambda gains, shares=shares: rule.worth(shares, gains), trial,
                             min(lasting(rig.seconds), left), rng)


def _trial(fits: Sequence[ModelFit], weights: np.ndarray,
           limits: Range) -> tuple[_Trial, np.ndarray]:
    """Where plans are tried on all pairs of the likeliest of `fits`, and the weights of these."""
    likely = [k for k in np.argsort(-weights, kind='stable')[:ASKED] if weights[k] > 0]
    pairs = [Question(fits[i], fits[j], 1.0) for i, j in combinations(likely, 2)]
    begin = float(fits[0].session_fits[0].session.times[-1]) + THOUGHT
    return _Trial.of(fits[0], pairs, Search({}, 1.0), begin, limits), weights[likely]


def _most_telling(worth: Callable[[np.ndarray], float], trial: _Trial, duration: float,
                  rng: np.random.Generator) -> Plan:
    """The plan of the most `worth` by its divergences, of as many as we try for ours."""
    def value(plan: Plan) -> float:
        outcome = trial.score(plan)
        return worth(_square(outcome.gains)) / outcome.spoilt

    limits = trial.limits
    drawn = [random_steps(rng, duration, limits) for _ in range(RANDOM)]
    drawn += [_draw(rng, duration, limits) for _ in range(PROPOSED)]
    values = [value(plan) for plan in drawn]
    best = int(np.argmax(values))
    plan, most = drawn[best], values[best]
    for k in range(IMPROVED):
        other = _change(rng, plan, drawn[int(rng.integers(len(drawn)))], limits, k)
        if (now := value(other)) > most:
            plan, most = other, now
    return plan


def _square(pairs: np.ndarray) -> np.ndarray:
    """A symmetric matrix (M, M) from what is above its diagonal, row by row."""
    count = round((1 + np.sqrt(1 + 8 * len(pairs))) / 2)
    square = np.zeros((count, count))
    square[np.triu_indices(count, 1)] = pairs
    return square + square.T


# The rules --------------------------------------------------------------------------------------

def probabilities(found: Sequence[CandidateFit]) -> np.ndarray:
    """π (M,) of no effect and of each of those `found`, alike before anything was seen."""
    return np.asarray(softmax([0.0, *map(log_bayes_factor, found)]))


def odds(weigh: Weigh) -> Sure:
    """How sure those weights are: the log odds of the largest against all others together."""
    def sure(found: Sequence[CandidateFit]) -> float:
        weights = np.sort(weigh(found))
        return float(np.log(weights[-1]) - np.log(max(weights[:-1].sum(), 1e-300)))
    return sure


def divergence(weights: np.ndarray, gains: np.ndarray) -> float:
    """Box and Hill's Σ πᵢ πⱼ over pairs of models times what sets them apart (M, M)."""
    return float(weights @ gains @ weights) / 2


def adequate(found: Sequence[CandidateFit]) -> np.ndarray:
    """The same weight (M,) for all models that χ² does not refuse, and none for the others.

    Counted from the least χ² of all, with as many degrees of freedom as that model has more than
    none: absolute χ² of 10⁴ rows spreads more than anything that is hidden here.
    """
    chance = np.exp(_log_chance(found))
    kept = chance >= REFUSED
    return np.asarray(kept / kept.sum())


def second_refused(found: Sequence[CandidateFit]) -> float:
    """How sure χ² is: the inverse of the chance of the second best, as log odds."""
    return float(-np.sort(_log_chance(found))[-2])


def _log_chance(found: Sequence[CandidateFit]) -> np.ndarray:
    """Of a χ² as much above that of the best, no effect and each of those `found` (M,)."""
    ratios = np.array([0.0, *(c.likelihood_ratio for c in found)])
    dof = [1, *(max(c.dof, 1) for c in found)]
    best = int(np.argmax(ratios))
    return np.asarray(chi2.logsf(ratios[best] - ratios, dof[best]))


def furthest(weights: np.ndarray, gains: np.ndarray) -> float:
    """Buzzi-Ferraris and Forzatti's largest divergence (M, M) of two models with any weight."""
    return float((gains * np.outer(weights > 0, weights > 0)).max())


def akaike_weights(found: Sequence[CandidateFit]) -> np.ndarray:
    """Of no effect, and of each of those `found` (M,): exp(−AIC/2), made to add up to 1."""
    return np.asarray(softmax([0.0, *(c.likelihood_ratio / 2 - c.dof for c in found)]))


def expected_weight(weights: np.ndarray, gains: np.ndarray) -> float:
    """Michalik and others' Σ wᵢ times the weight that i has, if it is right, after `gains` (M, M).
    """
    after = weights[:, None] / (weights[None, :] * np.exp(-gains)).sum(axis=1, keepdims=True)
    return float((weights * after[:, 0]).sum())


ODDS = float(np.log(DECIDED / (1 - DECIDED)))

RULES = {
    'box_hill': Rule(probabilities, odds(probabilities), ODDS, divergence),
    'buzzi_ferraris': Rule(adequate, second_refused, float(-np.log(REFUSED)), furthest),
    'akaike_weights': Rule(akaike_weights, odds(akaike_weights), ODDS, expected_weight)}
"""By the names that runs have."""
