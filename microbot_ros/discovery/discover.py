"""From sessions to a verdict: which effect is missing, how sure that is, what is left."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

import numpy as np

from microbot_ros.discovery.drive_levels import curve_p_value
from microbot_ros.discovery.experiment import next_experiment
from microbot_ros.discovery.held_out import held_out_gap, log_e_value
from microbot_ros.discovery.ladder import BACKWARD, FORWARD, Ladder, clearly, search, without
from microbot_ros.discovery.likelihood import Fit
from microbot_ros.discovery.maps import residual_maps
from microbot_ros.discovery.overlap import taken_back
from microbot_ros.discovery.result import (
    Discovery,
    Estimate,
    Limit,
    NamedEffect,
    Particle,
    ResidualMap,
    Status,
    Verdict,
)
from microbot_ros.discovery.screen import screen
from microbot_ros.discovery.search import LATE, Found, found_in, hidden_in_phi
from microbot_ros.estimation.phasor import polar
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.parameter import Parameter
from microbot_ros.model.particle import Fluid, stokes_drag
from microbot_ros.records import Session

SUGGESTED = 0.05
"""Chance, over the library, below which what is too weak for the model is still worth a word."""

CLOSE = 6.0
"""Difference in BIC within which two effects can't be told apart."""

HELD_OUT = float(np.log(20))
"""Logarithm of the e-value that an established effect has to reach."""

BETTER = 2.0
"""Gain in log p by which a map has to explain more than an effect, to make it a stand-in."""

ONE_SIDED = 1.645


def discover(sessions: Sequence[Session],
             report: Callable[[str], None] = lambda _: None,
             truth: Model | None = None, jobs: int = 1) -> Discovery:
    """Find, name and prove what the first-order model misses on sessions of one rig.

    Sessions share the effects; every session has its own particles and noise. `report` is told
    what is being done; `truth`, where it is known, is only judged by its gap; `jobs` processes
    share the candidates. Raises InputError where nothing can be learnt, and says what could.
    """
    evidences, remarks = screen(sessions)
    with ExitStack() as stack:
        run: Callable[..., Iterable[Found | None]] = map
        if jobs > 1:
            run = stack.enter_context(ProcessPoolExecutor(jobs)).map
        ladder = Ladder(evidences, partial(search, run=run))
        return _discover(ladder, remarks, report, truth)


def _discover(ladder: Ladder, remarks: tuple[str, ...], report: Callable[[str], None],
              truth: Model | None) -> Discovery:
    start = ladder.fit
    report('mapping what the first-order model leaves')
    before = residual_maps(start)
    ladder.climb(report)
    report('mapping what is left')
    after = residual_maps(ladder.fit) if ladder.fit.model.effects else before
    report('comparing with what could stand in')
    cases = [_Case.of(ladder, effect.id) for effect in ladder.fit.model.effects]
    unexplained = _worst([m for m in after if m.fires] + [m for c in cases for m in c.doubts])
    effects = [case.entry(bool(unexplained)) for case in cases or _suggestions(ladder.open)]
    rivals = [rival.fit.model for case in cases for rival in case.rivals]
    report('predicting what was held out')
    fit = ladder.fit
    return Discovery(
        verdict=_verdict(effects, unexplained),
        effects=tuple(sorted(effects, key=lambda e: (e.p_value, -e.delta_bic))),
        gap=held_out_gap(start, fit, truth),
        maps_before=before, maps_after=after, unexplained=unexplained, ladder=tuple(ladder.rungs),
        limits=tuple(limit for found in ladder.open for limit in _limits(found)),
        baseline=_particles(fit),
        diffusion=_mean([Estimate(p.diffusion, p.diffusion * np.sqrt(2 / p.freedom))
                         for p in fit.parts]),
        localisation=_localisation(fit),
        next_experiment=next_experiment(fit, rivals),
        model=fit.model,
        particles=_swimmers(fit),
        remarks=(*remarks, *_confounded(start)),
    )


def _verdict(effects: Sequence[NamedEffect], unexplained: Sequence[ResidualMap]) -> Verdict:
    if unexplained:
        return 'unnamed'
    return 'named' if any(e.status == 'established' for e in effects) else 'consistent'


@dataclass(frozen=True)
class _Case:
    """What speaks for an effect, and what against it.

    `own` is what it brings beside the others, `gain` the logarithm of its e-value, `sure` whether
    both vouch for it and nothing takes it back; `rivals` explain as much in its place; nothing
    could where it is `alone` in depending on the levels of the drive, and follows them. `doubts`
    are maps of the model without it: those that say more than it does, since something smooth
    that is in no library explains it better; all that fire, where it is not sure.
    """

    own: Found
    gain: float
    sure: bool
    alone: bool
    rivals: list[Found]
    doubts: list[ResidualMap]

    @classmethod
    def of(cls, ladder: Ladder, name: str) -> _Case:
        """The case of one effect of the ladder's model."""
        rest = without(ladder.fit, name)
        own = found_in(ladder.fit, rest, name)
        gain = log_e_value(ladder.fit, name)
        # Halves of a recording in which the frequency was stepped once predict nothing.
        alone = name == 'drive_response' and curve_p_value(ladder.fit) < BACKWARD
        sure = own.whole and own.delta_bic > CLOSE and not taken_back(ladder.fit, name) and (
            gain > HELD_OUT or alone)
        most = own.log_p + np.log(len(EFFECTS)) - BETTER if sure else 0.0
        return cls(
            own, gain, sure, alone,
            [rival for rival in ladder.rivals(name) if _close(rival, own) and not alone],
            [m for m in residual_maps(rest) if m.fires and m.log_p < most])

    def entry(self, incomplete: bool) -> NamedEffect:
        """As it is named; `incomplete`: whether what is established leaves something."""
        status: Status = 'established' if self.sure else 'suggested'
        if incomplete and not self.alone:
            status = 'proxy'
        return NamedEffect(
            self.own.id, status, _estimates(self.own.fit, self.own.id), self.own.delta_bic,
            self.own.p_value, float(np.exp(min(self.gain, 700.0))),
            tuple(rival.id for rival in self.rivals))


def _worst(maps: Iterable[ResidualMap]) -> tuple[ResidualMap, ...]:
    """One map against each covariate, the least likely by chance first."""
    found: dict[str, ResidualMap] = {}
    for one in sorted(maps, key=lambda m: m.p_value):
        found.setdefault(one.against, one)
    return tuple(found.values())


def _suggestions(found: Sequence[Found]) -> list[_Case]:
    """The best of what is too weak for a model that has none yet, or seen from one side only."""
    likely = [c for c in found if c.p_value * len(found) < SUGGESTED]
    if not likely:
        return []
    # The flank of a spot could stand in for anything smooth.
    best = next((c for c in likely if c.whole and not clearly(likely[0], c)), likely[0])
    rivals = [c for c in found if c is not best and _close(c, best)]
    return [_Case(best, log_e_value(best.fit, best.id), False, False, rivals, [])]


def _close(rival: Found, own: Found) -> bool:
    """Whether a rival that is worth a name explains about as much, as BIC or likelihood has it.

    The flank of a wide spot explains whatever a drift does: it has to explain it by less.
    """
    return rival.p_value < FORWARD and (rival.whole or not clearly(own, rival)) and (
        rival.delta_bic > own.delta_bic - CLOSE
        or rival.likelihood_ratio > own.likelihood_ratio - CLOSE)


def _confounded(fit: Fit) -> list[str]:
    """What φ can't be told from under the commands."""
    late = [name for name in LATE if hidden_in_phi(fit, EFFECTS[name])]
    if not late:
        return []
    return [f'φ can’t be told from {" or ".join(late)} under this command, which turns one way '
            'only: turn both ways, or in steps.']


def _deviations(fit: Fit, name: str) -> list[tuple[Parameter, float, float]]:
    """The parameters of an effect with value and standard deviation in fit coordinates."""
    std = np.sqrt(np.diag(fit.covariance))
    return [
        (parameter, float(x), float(s))
        for (effect, parameter), x, s in zip(
            fit.model.parameters, fit.model.vector(), std, strict=True)
        if effect == name
    ]


def _estimates(fit: Fit, name: str) -> dict[str, Estimate]:
    """Parameters in SI; of a reciprocal coordinate by the delta method."""
    result = {}
    for parameter, x, std in _deviations(fit, name):
        slope = parameter.scale / x**2 if parameter.inverse and x else parameter.scale
        result[parameter.name] = Estimate(parameter.from_fit(x), std * slope)
    return result


def _limits(found: Found) -> list[Limit]:
    """How large the strengths of an effect that is not supported may still be."""
    limits = []
    for parameter, x, std in _deviations(found.fit, found.id):
        if not parameter.shape:
            most = abs(x) + ONE_SIDED * std
            inside = most <= max(map(abs, parameter.fit_bounds))
            limits.append(Limit(
                found.id, parameter, parameter.from_fit(most) if inside else float('nan')))
    return limits


def _particles(fit: Fit) -> tuple[Particle, ...]:
    """Speed, φ and force of every particle under the final model."""
    result = []
    for p in fit.parts:
        e = p.evidence
        power = np.trace(p.gram[:, 1:, 1:], axis1=1, axis2=2) / 2
        std = np.sqrt(p.diffusion / np.maximum(power, 1e-300))
        swims = polar(p.swim[e.first_track], std)
        drag = np.nan
        known = e.conditions
        if known.radius and known.viscosity and fit.model.propulsion == 'catalytic':
            drag = stokes_drag(Fluid(known.viscosity), known.radius)
        for n, name in enumerate(e.ids[e.first_track]):
            label = str(name) if len(fit.parts) == 1 else f'{e.name}:{name}'
            result.append(Particle(
                label, Estimate(float(swims.speed[n]), float(swims.speed_std[n])),
                Estimate(float(swims.phi[n]), float(swims.phi_std[n])),
                Estimate(float(drag * swims.speed[n]), float(drag * swims.speed_std[n]))))
    return tuple(result)


def _swimmers(fit: Fit) -> ParticleParameters:
    """The particles of the last session."""
    last = fit.parts[-1]
    first = last.evidence.first_track
    return ParticleParameters.from_velocity_phasor(last.evidence.ids[first], last.swim[first])


def _localisation(fit: Fit) -> Estimate:
    """As for a strobe: an exposure would add a third of D times its length to σ²."""
    return _mean([
        Estimate(float(np.sqrt(max(p.whitening.excess, 0.0) * p.diffusion)), float('nan'))
        for p in fit.parts
    ])


def _mean(values: list[Estimate]) -> Estimate:
    value, std = (np.array([getattr(e, part) for e in values]) for part in ('value', 'std'))
    return Estimate(float(value.mean()), float(np.sqrt((std**2).sum()) / len(values)))

