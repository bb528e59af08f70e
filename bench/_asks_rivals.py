"""What is asked and when it ends by the rules of the literature, on the same worlds and fits.

Box and Hill (Technometrics 9, 57, 1967) choose what makes the expected divergence between models,
weighted by how likely they are, largest; Akaike weights (Buzzi-Ferraris and Forzatti's order of
models by χ² is no other for equal numbers of parameters) end when one model holds 0.999 of the
weight, as in GPdoemd (Olofsson and others, Comput. Chem. Eng. 125, 54, 2019), which measured them
best. Without refitting the other model, and without a price for looking again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench._driven_rig import SimulatedRig
from microbot_ros.discovery.driven.design import (
    Design,
    Question,
    Range,
    Search,
    choose_plan,
    random_steps,
)
from microbot_ros.discovery.driven.drive import EXPERIMENT, SHORTEST
from microbot_ros.discovery.driven.joined import join
from microbot_ros.discovery.search import CandidateFit
from microbot_ros.discovery.stepwise_selection import search
from microbot_ros.estimation.model_fit import ModelFit, fit_sessions
from microbot_ros.estimation.prepared_session import prepare
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

DECIDED = 0.999
"""Akaike weight at which a model is taken."""

ASKED = 5
"""The likeliest models, between which divergence is counted."""


@dataclass(frozen=True)
class Taken:
    """The `name` that was taken, '' for none, after so many `seconds`; None: time was out."""

    name: str | None
    seconds: float


def by_akaike_weights(rig: SimulatedRig, minutes: float, seed: int) -> Taken:
    """Drive a `rig` by those rules for as many `minutes` at most; `seed` draws the plans."""
    rng, sessions = np.random.default_rng(seed), []
    plan = random_steps(rng, EXPERIMENT, rig.limits)
    while True:
        sessions.append(rig.play(plan).session)
        session = prepare(join(sessions))
        plain = fit_sessions(Model.baseline(session.conditions, session.commands), [session])
        found = search(plain, EFFECTS)
        weights = _weights(found)
        best = int(np.argmax(weights))
        if weights[best] > DECIDED:
            return Taken(found[best - 1].id if best else '', rig.seconds)
        if 60 * minutes - rig.seconds < SHORTEST:
            return Taken(None, rig.seconds)
        plan = _diverging(plain, found, weights, float(session.times[-1]) + 2.0, rig.limits,
                          rng).plan


def _weights(found: list[CandidateFit]) -> np.ndarray:
    """Of no effect, and of each: exp(−AIC/2), made to add up to 1."""
    logs = np.array([0.0, *(c.likelihood_ratio / 2 - c.dof for c in found)])
    share = np.exp(logs - logs.max())
    return np.asarray(share / share.sum())


def _diverging(plain: ModelFit, found: list[CandidateFit], weights: np.ndarray, begin: float,
               limits: Range, rng: np.random.Generator) -> Design:
    fits = [plain, *(c.fit for c in found)]
    likely = np.argsort(-weights)[:ASKED]
    # A large sum of weighted divergences is a short weighted mean of times to a far goal.
    pairs = [Question(fits[i], fits[j], 1e3, float(weights[i] * weights[j]) / 2)
             for i in likely for j in likely if i < j]
    return choose_plan(plain, pairs, Search({}, 1.0), begin, EXPERIMENT, limits, rng)
