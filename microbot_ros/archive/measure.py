"""Size of given effects in one session, whether or not they were found there.

The spread of an effect must not be estimated only from those sessions in which it was large enough
to be found: each session gives its own estimate, with its error, and the likelihood ratio of the
effect.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.search import CandidateFit, contribution, fit_candidate
from microbot_ros.estimation.likelihood.model_fit import fit_sessions
from microbot_ros.model.io.effect_table import build_effects
from microbot_ros.model.model import Model


def measure(session: Session, effects: list[str], known: dict[str, dict[str, float]],
            reference_field: float) -> dict[str, Any]:
    """Estimate effects in a session.

    Parameters
    ----------
    session : Session
        The session.
    effects : list of str
        Ids of the effects.
    known : dict[str, dict of str to float]
        Effects that are known there: values by parameter, in the units of the names, by id.
    reference_field : float
        Field [T] at which all sessions state their alignment times.

    Returns
    -------
    dict of str to object
        As in JSON: {effect: {'parameters': {name: [x, std]}, 'likelihood_ratio', 'dof',
        'p_value'}}, x and std in fit coordinates; null if the session cannot show the effect.
    """
    [prepared], _ = check_sessions([session])
    conditions = replace(session.conditions, reference_field=reference_field)
    start = replace(Model.baseline(conditions, session.commands), effects=build_effects(known))
    fit = fit_sessions(start, [prepared])
    found = {name: contribution(fit, name) if fit.model.effect(name) else fit_candidate(fit, name)
             for name in effects}
    return {'effects': {name: one and _told(one) for name, one in found.items()}}


def _told(found: CandidateFit) -> dict[str, Any]:
    fit = found.fit
    stds = np.sqrt(np.diag(fit.covariance))
    return {
        'parameters': {
            parameter.name: [float(x), float(std) if np.isfinite(std) else None]
            for (effect, parameter), x, std in zip(
                fit.model.parameters, fit.model.vector(), stds, strict=True)
            if effect == found.id},
        'likelihood_ratio': float(max(found.likelihood_ratio, 0.0)), 'dof': found.dof,
        'p_value': found.p_value}
