"""Whether 95 % intervals hold the truth 95 times in 100: of everything that is published.

Sessions as in the suite, fitted with the effect that is hidden in them. Radius and viscosity are
stated wrongly by 5 % each, which is what the interval of F allows for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bench._hidden_suite import FLUID, Blind
from bench._score_card import Case, one_each, truths
from microbot_ros.common.records import Session
from microbot_ros.discovery.intervals import Intervals
from microbot_ros.discovery.result import Estimate
from microbot_ros.discovery.search import fit_candidate
from microbot_ros.estimation.likelihood.model_fit import ModelFit, fit_sessions
from microbot_ros.estimation.likelihood.prepared_session import prepare
from microbot_ros.model.model import Model
from microbot_ros.model.physics.particle import stokes_drag


@dataclass(frozen=True)
class Covered:
    """Of what `kind` and under which `effect`, whether an interval `held` the truth."""

    kind: str
    effect: str
    held: bool


def cases(sets: int) -> list[Case]:
    """Each effect that many times, and as often none."""
    hidden = one_each('coverage', 100.0, sets, 300_000)
    return [*hidden, *(replace(hidden[k], effects=(), evidence=0.0) for k in range(sets))]


def judge(case: Case) -> list[Covered]:
    """All that is published of one session."""
    drawn = case.draw()
    name = case.effects[0] if case.effects else ''
    fit = _fitted(_misstated(drawn.session, case.seed), name)
    return [] if fit is None else [
        Covered(kind, name, bool(estimate.low <= true <= estimate.high))
        for kind, estimate, true in _published(drawn, fit, name) if np.isfinite(estimate.value)]


def _misstated(session: Session, seed: int) -> Session:
    known = session.conditions
    if not (known.radius and known.viscosity):
        return session
    off = 1 + 0.05 * np.random.default_rng(seed).normal(size=2)
    return replace(session, conditions=replace(
        known, radius=known.radius * off[0], viscosity=known.viscosity * off[1]))


def _fitted(session: Session, name: str) -> ModelFit | None:
    sessions = [prepare(session)]
    fit = fit_sessions(Model.baseline(session.conditions, session.commands), sessions)
    if not name:
        return fit
    found = fit_candidate(fit, name)
    return fit_sessions(found.fit.model, sessions) if found else None


def _published(drawn: Blind, fit: ModelFit, name: str) -> Iterator[tuple[str, Estimate, float]]:
    """Kind, estimate and truth."""
    known, swarm, camera = Intervals(fit), drawn.swarm, drawn.camera
    rolling = drawn.session.conditions.propulsion == 'rolling'
    for found, body in zip(known.particles(), swarm, strict=True):
        speed = float(body['gain' if rolling else 'speed'])
        turned = found.phi.value + np.angle(np.exp(1j * (body['phi'] - found.phi.value)))
        yield from (('v', found.speed, speed), ('φ', found.phi, float(turned)),
                    ('F', found.force, stokes_drag(FLUID, body['radius']) * speed))
    diffusion = float(swarm['diffusion'][0])
    blurred = diffusion * camera.exposure / camera.frame_rate / 3
    yield 'D', known.diffusion(), diffusion
    yield 'σ', known.localisation(), math.sqrt(max(camera.noise**2 - blurred, 0.0))
    if name:
        for estimate, true in truths(drawn, name, known.effect(name), fit.model):
            yield 'parameters', estimate, true
