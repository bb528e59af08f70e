"""Search sessions of one rig for missing effects: the verdict, its certainty and what remains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.common.units import suffix, symbol
from microbot_ros.discovery.check.held_out import hold_out
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.check.score_tests import residual_maps
from microbot_ros.discovery.check.time_shift import time_shifts
from microbot_ros.discovery.evidence import FitEvidence
from microbot_ros.discovery.hypotheses import Candidate, Hypotheses, consider
from microbot_ros.discovery.intervals import Intervals
from microbot_ros.discovery.learned.learn import (
    Finding,
    learn_terms,
    relearn,
    with_terms,
)
from microbot_ros.discovery.learned.likeness import confirmation, looks_like
from microbot_ros.discovery.next_experiment import next_experiment
from microbot_ros.discovery.processes import Run, in_processes, serially
from microbot_ros.discovery.report.words import bare, words
from microbot_ros.discovery.result import (
    Considered,
    Discovery,
    Learned,
    Limit,
    NamedEffect,
    ResidualMap,
)
from microbot_ros.discovery.verdict import Judgement, judge, scrutinised
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.estimation.likelihood.noise import implausible_diffusion
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.parameter import Parameter

ONE_SIDED = 1.645
"""95 % quantile of the standard normal distribution, for one-sided upper limits."""

ALIKE = 0.1
"""Relative difference of two speeds above which a remark states both.

Choice: a smaller value adds remarks about differences that hardly matter, a larger one hides some
that a reader of both results would ask about.
"""

NOTED = 0.02
"""Fluctuation above which a remark states it: of a speed or a step as a fraction, of a direction
in radians, of the time of a command in frame intervals.

Choice: a smaller value adds remarks on noise that no figure shows, a larger one hides some."""

TRAVELLED = 10e-6
"""Distance [m] for which a remark states the variation of a step.

Choice: a few diameters of a usual particle; it changes the remark only, not the verdict.
"""


def discover(sessions: Sequence[Session],
             report: Callable[[str], None] = lambda _: None,
             truth: Model | None = None, jobs: int = 1) -> Discovery:
    """Find, name and test the effects that the first-order model lacks.

    All sessions share the effects. Each session has its own particles and noise.

    Parameters
    ----------
    sessions : sequence of Session
        Recordings of one rig.
    report : callable, optional
        Receives one line of progress before each stage.
    truth : Model, optional
        The true model of a simulation. Only its prediction gap is computed from it.
    jobs : int, optional
        Number of processes that share candidates, residual maps, held-out blocks and plans.

    Returns
    -------
    Discovery
        Verdict, effects, prediction gap, limits and the next experiment, in SI units.

    Raises
    ------
    InputError
        If nothing can be learnt from the sessions; the message says what could be recorded.
    """
    prepared, remarks = check_sessions(sessions)
    run: Run = partial(in_processes, jobs=jobs) if jobs > 1 else serially
    known = consider(prepared, (), report, run)
    report('mapping the residuals')
    judgement = judge(known, run)
    report('asking whether something is there that no name explains')
    judgement = scrutinised(known, judgement, report)
    start = known.start
    learned = _learned(known, report) if judgement.left else None
    report('predicting held-out data')
    predicted = hold_out(
        learned.fit if learned else known.fit, [p.session for p in start.session_fits],
        known.credible, truth, run, partial(relearn, learned.findings) if learned else None)
    beyond = 'before' if judgement.rests_on_doubt(known) else 'after'
    if judgement.left and not predicted.worth_explaining(known.fit, beyond):
        judgement = judgement.foretelling_nothing()
    complete = judgement.verdict != 'unnamed'
    if complete:
        learned = None
    fit = learned.fit if learned else known.fit
    intervals = Intervals(known.fit, complete, known.within_reach() if complete else ())
    effects = [NamedEffect(
        slot.own.id, judgement.status(slot.own.id), intervals.effect(slot.own.id),
        slot.own.evidence, slot.own.found.delta_bic, slot.own.found.p_value,
        tuple(one.id for one in slot.within_reach)) for slot in known.slots]
    if learned:
        intervals = Intervals(fit, complete=False)
    return Discovery(
        verdict=judgement.verdict,
        effects=tuple(sorted(effects, key=lambda e: -e.log_evidence)),
        gap=predicted.gap(fit),
        maps_before=residual_maps(start, run) if known.slots else judgement.maps,
        maps_after=judgement.maps,
        unexplained=_worst([*judgement.left, *judgement.beside]),
        considered=tuple(Considered(
            one.id, one.evidence, one.found.likelihood_ratio, one.found.dof,
            one.found.delta_bic, one.found.p_value) for one in known.more),
        limits=tuple(limit for one in known.more for limit in _limits(one)),
        baseline=intervals.particles(),
        diffusion=intervals.diffusion(),
        localisation=intervals.localisation(),
        next_experiment=(
            confirmation(learned.findings[0], FitEvidence(start).duration / 60) if learned
            else next_experiment(fit, [one.found.fit.model for slot in known.slots
                                       for one in slot.within_reach], run)),
        model=fit.model,
        particles=_particle_parameters(fit),
        remarks=(*remarks, *_interrupted(start), *_reservations(known, judgement),
                 *_shifted(known.fit), *_confounded(start), *_not_thermal(fit), *_unsteady(fit),
                 *_unlike_fit(start, fit), *_beyond_commands(fit)),
        learned=_told(learned) if learned else (),
    )


@dataclass(frozen=True)
class _Terms:
    """Learned terms: the `findings`, the `fit` with them, and its log `evidence`."""

    findings: tuple[Finding, ...]
    fit: ModelFit
    evidence: float

    @classmethod
    def of(cls, findings: tuple[Finding, ...], rest: ModelFit, evidence: float) -> _Terms:
        """Add `findings` to a fit `rest`, with log `evidence` over the first-order model."""
        fit = with_terms(rest, findings)
        gained = fit.log_likelihood - rest.log_likelihood
        return cls(findings, fit, evidence + gained - sum(
            one.gain - one.log_evidence for one in findings))


def _learned(known: Hypotheses, report: Callable[[str], None]) -> _Terms | None:
    """Return learned terms beside the effects that were found, or without these: the likelier.

    Effects that stand in for an unknown cause hide it, so both fits are tried.
    """
    beside = [(known.start, 0.0)]
    if known.slots:
        beside.insert(0, (known.fit, known.evidence))
    found = [_Terms.of(findings, fit, evidence) for fit, evidence in beside
             if (findings := learn_terms(fit, known.term_beside(fit, report), report))]
    return max(found, key=lambda one: one.evidence, default=None)


def _told(learned: _Terms) -> tuple[Learned, ...]:
    """Return the learned terms, each with the covariates that still show structure."""
    left = tuple(m.against for m in _worst(m for m in residual_maps(learned.fit) if m.fires))
    return tuple(Learned(found.term, looks_like(found), found.log_evidence, found.odds, left)
                 for found in learned.findings)


def _worst(maps: Iterable[ResidualMap]) -> tuple[ResidualMap, ...]:
    """Return one map per covariate, sorted by p-value."""
    found: dict[str, ResidualMap] = {}
    for one in sorted(maps, key=lambda m: m.p_value):
        found.setdefault(one.against, one)
    return tuple(found.values())


def _reservations(known: Hypotheses, judgement: Judgement) -> list[str]:
    """Return a sentence on each effect that is not named, or was recorded briefly, with why."""
    told = []
    for name in judgement.of_instrument:
        effect = known.fit.model.effect(name)
        assert effect is not None
        floors = ', '.join(f'{p.meaning} {p.display_units(p.floor):g} {symbol(p.name)}'.strip()
                           for p in effect.parameters() if p.floor)
        told.append(f'{words(name)}: too small to be distinguished from an error of camera, time '
                    f'stamps or coils, and not named (floor: {floors}).')
    told += [
        f'{words(name)}: not the same in the whole recording, and not named. Its strength in one '
        'half, of the time or of the particles, predicts the other half worse than no effect.'
        for name in judgement.contradicted]
    told += [
        f'{words(name)}: not named, since it may stand in for another cause, which explains more '
        'or whose shape the recording does not show.' for name in dict.fromkeys(judgement.doubted)
        if not (judgement.left or name in (*judgement.named, *judgement.contradicted))]
    return told + [
        f'{words(name)}: recorded for less than {EFFECTS[name].lookalike_time:.0f} s. In that '
        'time another quantity that varies with position or time can look like it.'
        for name in judgement.early]


def _interrupted(fit: ModelFit) -> list[str]:
    """Return a sentence per session on stretches that were left out as interruptions."""
    told = []
    for session in (p.session for p in fit.session_fits):
        parts = [f'{"all particles" if one.particle is None else f"particle {one.particle}"} '
                 f'from {one.begin:.1f} to {one.end:.1f} s' for one in session.interruptions]
        if parts:
            told.append(f'{session.name}: not moving as commanded, and left out: '
                        f'{", ".join(parts)} after the first frame. Did particles stick or touch '
                        'something, or are commands missing in the log?')
    return told


def _shifted(fit: ModelFit) -> list[str]:
    """Return a sentence for each session whose clocks disagree by less than a frame."""
    return [
        f'{p.session.name}: commands act {abs(one.shift) * 1e3:.2g} ± {one.std * 1e3:.1g} ms '
        f'{"later" if one.shift > 0 else "earlier"} than their times, which is less than a frame '
        f'({one.interval * 1e3:.3g} ms). An error of the time stamps looks the same, so it counts '
        'as no effect.'
        for p, one in zip(fit.session_fits, time_shifts(fit), strict=True)
        if one and one.is_noted]


def _not_thermal(fit: ModelFit) -> list[str]:
    """Return a sentence for each session whose D differs from its expected thermal value."""
    return [f'{p.session.name}: {one}.' for p in fit.session_fits
            for one in implausible_diffusion(p.session.conditions, p.noise())]


def _unsteady(fit: ModelFit) -> list[str]:
    """Return a sentence per session on fluctuations of velocity, which are part of the noise."""
    told = []
    for p in fit.session_fits:
        if p.whitening.fluctuation is None:
            continue
        parts = {
            f'speeds fluctuate by {100 * p.fluctuation:.0f} % with a correlation time of '
            f'{p.whitening.fluctuation:.2g} s': p.fluctuation > NOTED,
            f'directions of travel fluctuate by {np.degrees(p.wander):.1f}°': p.wander > NOTED,
            f'a step of {TRAVELLED * 1e6:g} µm varies by {p.unevenness(TRAVELLED) * 1e6:.2g} µm':
                p.unevenness(TRAVELLED) > NOTED * TRAVELLED,
            'positions oscillate along the motion by '
            f'{p.swing * 1e6:.2g} µm (standard deviation), as for '
            'particles that roll unevenly': p.swing > p.localisation,
            f'commands act up to {p.jitter * 1e3:.2g} ms (standard deviation) earlier or later '
            'than usual': p.jitter > NOTED * p.session.interval,
        }
        if found := [one for one, noted in parts.items() if noted]:
            told.append(f'{p.session.name}: {"; ".join(found)}. This is part of the noise.')
    return told


def _unlike_fit(start: ModelFit, fit: ModelFit) -> list[str]:
    """Return why speeds differ from the first-order model; empty up to a difference of ALIKE."""
    before, after = (np.concatenate([
        np.abs(p.velocity_phasor[p.session.main]) for p in one.session_fits])
        for one in (start, fit))
    moved = (before > 0) & (after > 0)
    if not moved.any() or np.abs(np.log(after[moved] / before[moved])).max() < np.log1p(ALIKE):
        return []
    what, unit = ('gain', 'µm/s/Hz') if fit.model.propulsion == 'rolling' else ('speed', 'µm/s')
    usual, found = (float(np.median(one[moved])) * 1e6 for one in (before, after))
    unsteady = any(p.whitening.fluctuation is not None for p in start.session_fits)
    return [f'The {what} is {found:.3g} {unit} (median) with the effects and {usual:.3g} '
            f'{unit} in the first-order model: the effects change the mean speed.'
            + (' microbot fit weighs fast and slow parts differently, as speeds do not fluctuate '
               'in its noise.' if unsteady else '')]


def _beyond_commands(fit: ModelFit) -> list[str]:
    """Return the corner frequencies of drive responses outside the commanded frequencies."""
    used = FitEvidence(fit).frequencies
    driven = used[used > 0]
    told = []
    for effect in fit.model.effects:
        if not effect.is_drive_curve or not driven.size:
            continue
        corners = {bare(p.name): value for p, value in effect.values().items()
                   if suffix(p.name) == '_hz'}
        if out := [name for name, value in corners.items()
                   if 0 < value < driven[0] or value > driven[-1]]:
            told.append(
                f'{words(effect.id)}: {" and ".join(out)} outside the commanded frequencies, '
                f'{driven[0]:g} to {driven[-1]:g} Hz. The curve is known between these; the '
                'corner, and the gain with it, are not.')
    return told


def _confounded(fit: ModelFit) -> list[str]:
    """Return which effects the commands do not let one tell from φ."""
    evidence = FitEvidence(fit)
    late = [name for name, effect in EFFECTS.items() if effect.absorbed_by_phi(evidence)]
    if not late:
        return []
    return [f'φ cannot be distinguished from {" or ".join(late)} under this command, which turns '
            'one way only: turn both ways, or in steps.']


def _deviations(fit: ModelFit, name: str) -> list[tuple[Parameter, float, float]]:
    """Return the parameters of an effect with value and standard deviation in fit coordinates."""
    std = np.sqrt(np.diag(fit.covariance))
    return [
        (parameter, float(x), float(s))
        for (effect, parameter), x, s in zip(
            fit.model.parameters, fit.model.vector(), std, strict=True)
        if effect == name
    ]


def _limits(one: Candidate) -> list[Limit]:
    """Return 95 % upper limits of the strengths of an effect that is not supported."""
    limits = []
    for parameter, x, std in _deviations(one.found.fit, one.id):
        if not parameter.shape:
            most = abs(x) + ONE_SIDED * std
            inside = most <= max(map(abs, parameter.fit_bounds))
            limits.append(Limit(
                one.id, parameter, parameter.from_fit(most) if inside else float('nan')))
    return limits


def _particle_parameters(fit: ModelFit) -> ParticleParameters:
    """Return the parameters of the particles of the last session."""
    last = fit.session_fits[-1]
    main = last.session.main
    return ParticleParameters.from_velocity_phasor(
        last.session.ids[main], last.velocity_phasor[main])

