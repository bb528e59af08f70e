"""From sessions to a verdict: which effect is missing, how sure that is, what is left."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from microbot_ros.discovery.drive_levels import curve_p_value
from microbot_ros.discovery.evidence import FitEvidence
from microbot_ros.discovery.held_out import held_out_gap, log_e_value
from microbot_ros.discovery.input_checks import check_sessions
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
from microbot_ros.discovery.result import (
    Discovery,
    Learned,
    Limit,
    NamedEffect,
    ResidualMap,
    Status,
    Verdict,
)
from microbot_ros.discovery.score_tests import residual_maps
from microbot_ros.discovery.search import CandidateFit, compare
from microbot_ros.discovery.stand_ins import series_for_a_field
from microbot_ros.discovery.stepwise_selection import (
    BACKWARD,
    FORWARD,
    StepwiseSelection,
    clearly_better,
    is_cancelled,
    search,
    without,
)
from microbot_ros.estimation.model_fit import ModelFit
from microbot_ros.estimation.noise import implausible_diffusion
from microbot_ros.estimation.prepared_session import PreparedSession
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.parameter import Parameter
from microbot_ros.records import Session

SUGGESTED = 0.05
"""Chance, over the library, below which what is too weak for the model is still worth a word."""

CLOSE = 6.0
"""Difference in BIC within which two effects can't be told apart."""

HELD_OUT = float(np.log(20))
"""Logarithm of the e-value that an established effect has to reach."""

BETTER = 2.0
"""Gain in log p by which a map has to explain more than an effect, to make it a stand-in."""

DWARFED = 0.02
"""Part of an effect's evidence up to which what is left does not call it into question."""

ONE_SIDED = 1.645


def discover(sessions: Sequence[Session],
             report: Callable[[str], None] = lambda _: None,
             truth: Model | None = None, jobs: int = 1) -> Discovery:
    """Find, name and prove what the first-order model misses on sessions of one rig.

    Sessions share the effects; every session has its own particles and noise. `report` is told
    what is being done; `truth`, where it is known, is only judged by its gap; `jobs` processes
    share candidates, maps, halves, blocks and plans. Raises InputError where nothing can be
    learnt, and says what could.
    """
    prepared, remarks = check_sessions(sessions)
    run: Run = partial(in_processes, jobs=jobs) if jobs > 1 else serially
    selection = StepwiseSelection(prepared, partial(search, run=run))
    selection.run(report)
    return conclude(selection, remarks, report, truth, run)


def conclude(selection: StepwiseSelection, remarks: tuple[str, ...],
             report: Callable[[str], None], truth: Model | None = None,
             run: Run = serially, *, decided: Verdict | None = None) -> Discovery:
    """The result of a `selection` that has been made, with `remarks` on its sessions.

    `report` and `truth` as for `discover`; `run` shares the work. `decided`: the verdict where it
    is known, whatever is said here of what is left.
    """
    report('mapping what is left')
    start = selection.start
    before = residual_maps(start, run)
    after = (residual_maps(selection.current, run) if selection.current.model.effects
             else before)
    report('comparing with what could stand in')
    left = [m for m in after if m.fires]
    assessments = [_Assessment.of(selection, effect.id, left, run)
                   for effect in selection.current.model.effects]
    doubts = [m for one in assessments for m in one.doubts]
    decisive = any(not m.cut_out for m in left + doubts)
    unexplained = _worst(left + doubts)
    weak = [] if assessments else _suggestions(selection.open, selection.sessions, run)
    fit = selection.current
    known = Intervals(fit, complete=all(one.dwarfs for one in assessments))
    effects = [one.entry(known, bool(doubts)) for one in assessments] + [
        one.entry(Intervals(one.own.fit), decisive) for one in weak]
    told = not doubts and any(one.sure and one.dwarfs for one in assessments)
    rivals = [rival.fit.model for one in assessments for rival in one.rivals]
    verdict = decided or _verdict(effects, decisive and not told)
    series = series_for_a_field(fit, report) if verdict == 'named' and not decided else None
    if series:
        verdict, unexplained = 'unnamed', _worst(
            m for m in residual_maps(series.rest, run) if m.fires)
    if verdict == 'unnamed':
        stand_ins = series.names if series else [e.id for e in effects if decided]
        effects = [replace(e, status='proxy') if e.id in stand_ins else e for e in effects]
    learned = _learned(selection, effects, report) if verdict == 'unnamed' else None
    if verdict == 'unnamed':
        effects = [replace(e, status='proxy') if e.status == 'established' else e for e in effects]
    if learned:
        fit = learned.fit
        known = Intervals(fit, complete=False)
    report('predicting what was held out')
    return Discovery(
        verdict=verdict,
        effects=tuple(sorted(effects, key=lambda e: (e.p_value, -e.delta_bic))),
        gap=held_out_gap(fit, selection.sessions, truth, run,
                         partial(relearn, learned.findings) if learned else None),
        maps_before=before, maps_after=after, unexplained=unexplained,
        selection=tuple(selection.steps),
        limits=tuple(limit for found in selection.open for limit in _limits(found)),
        baseline=known.particles(),
        diffusion=known.diffusion(),
        localisation=known.localisation(),
        next_experiment=(
            confirmation(learned.findings[0], FitEvidence(start).duration / 60) if learned
            else next_experiment(fit, rivals, run)),
        model=fit.model,
        particles=_particle_parameters(fit),
        remarks=(*remarks, *_confounded(start), *_not_thermal(fit)),
        learned=_told(learned) if learned else (),
    )


@dataclass(frozen=True)
class _Terms:
    """Terms that were learned: the `findings`, and the `fit` with them."""

    findings: tuple[Finding, ...]
    fit: ModelFit


def _learned(selection: StepwiseSelection, effects: Sequence[NamedEffect],
             report: Callable[[str], None]) -> _Terms | None:
    """Terms for what no effect explains, where they explain most.

    Beside all effects that were found, or, since those that only stand in for it are in its way,
    beside none but the established ones.
    """
    sure = {e.id for e in effects if e.status == 'established'}
    beside = [selection.current]
    if any(e.id not in sure for e in beside[0].model.effects):
        beside.append(selection.fit(replace(beside[0].model, effects=tuple(
            e for e in beside[0].model.effects if e.id in sure))))
    found = [_Terms(findings, with_terms(fit, findings)) for fit in beside
             if (findings := learn_terms(fit, report))]
    return max(found, key=_support, default=None)


def _support(terms: _Terms) -> float:
    """Log likelihood with terms, as BIC prices effects and the evidence the terms."""
    fit, found = terms.fit, terms.findings
    price = np.log(fit.count) / 2 * len(fit.model.vector()) + sum(
        one.gain - one.log_evidence for one in found)
    return float(fit.log_likelihood - price)


def _told(learned: _Terms) -> tuple[Learned, ...]:
    """What was `learned`, and what is left with all of it."""
    left = tuple(m.against for m in _worst(m for m in residual_maps(learned.fit) if m.fires))
    return tuple(Learned(found.term, looks_like(found), found.log_evidence, found.odds, left)
                 for found in learned.findings)


def _verdict(effects: Sequence[NamedEffect], incomplete: bool) -> Verdict:
    if incomplete:
        return 'unnamed'
    return 'named' if any(e.status == 'established' for e in effects) else 'consistent'


@dataclass(frozen=True)
class _Assessment:
    """Whether an effect of the selected model is established.

    `own`: its comparison with the model without it; `log_e_value`: its gain in log likelihood on
    data that it was not fitted to, less what the choice among the library costs. `sure`: both
    pass and no other effect cancels it. `rivals` explain as much in its place; none can where it
    is `alone`: one whose curve the gains at the levels of the drive follow.
    `doubts`: of the maps of the residual without it, those that are less likely by chance than it
    is, since something smooth that is in no library explains it better; all that fire, where it
    is not sure. `dwarfs`: whether it dwarfs what is left. Where it does not, and is not `alone`,
    it may be but a part of something else: then nothing more is asked, and `log_e_value` is NaN.
    """

    own: CandidateFit
    log_e_value: float
    sure: bool
    alone: bool
    rivals: list[CandidateFit]
    doubts: list[ResidualMap]
    dwarfs: bool = True

    @classmethod
    def of(cls, selection: StepwiseSelection, name: str,
           left: Iterable[ResidualMap], run: Run) -> _Assessment:
        """Of the effect `name` of the model selected so far, beside which maps find so much
        `left`.
        """
        rest = without(selection.current, name)
        own, maps = compare(selection.current, rest, name), residual_maps(rest, run)
        # Halves of a recording in which the frequency was stepped once predict nothing.
        alone = (EFFECTS[name].is_drive_curve
                 and curve_p_value(selection.current, name) < BACKWARD)
        dwarfs = _dwarfs(own, maps, left)
        if not dwarfs and not alone:
            return cls(own, float('nan'), False, False, [], [], dwarfs)
        gain = _paid_log_e_value(selection.current.model, selection.sessions, name, run)
        sure = own.shape_seen and own.delta_bic > CLOSE and not is_cancelled(
            selection.current, name) and (gain > HELD_OUT or alone)
        most = own.log_p + np.log(len(EFFECTS)) - BETTER if sure else 0.0
        return cls(
            own, gain, sure, alone,
            [rival for rival in selection.rivals(name) if _close(rival, own) and not alone],
            [m for m in maps if m.fires and not m.cut_out and m.log_p < most], dwarfs)

    def entry(self, known: Intervals, doubted: bool) -> NamedEffect:
        """As it is named, with what is `known` of its fit.

        `doubted`: whether something smooth that is in no library explains an effect better.
        """
        status: Status = 'established' if self.sure else 'suggested'
        if not self.alone and (doubted or not self.dwarfs):
            status = 'proxy'
        return NamedEffect(
            self.own.id, status, known.effect(self.own.id), self.own.delta_bic,
            self.own.p_value, float(np.exp(np.minimum(self.log_e_value, 700.0))),
            tuple(rival.id for rival in self.rivals))


def _dwarfs(own: CandidateFit, without: Iterable[ResidualMap],
            left: Iterable[ResidualMap]) -> bool:
    """Whether what is `left` is small beside an effect, and of another kind.

    What only stands in for something else explains less of it, and leaves more of the same, in
    the map that shows most `without` it. Steps that were cut out are in no fit.
    """
    worst = max((m for m in left if not m.cut_out), key=_excess, default=None)
    return worst is None or (worst.against != max(without, key=_excess).against
                             and _excess(worst) < DWARFED * own.likelihood_ratio)


def _excess(found: ResidualMap) -> float:
    """Evidence in a map beyond what chance gives."""
    return found.statistic - found.dof


def _worst(maps: Iterable[ResidualMap]) -> tuple[ResidualMap, ...]:
    """One map against each covariate, the least likely by chance first."""
    found: dict[str, ResidualMap] = {}
    for one in sorted(maps, key=lambda m: m.p_value):
        found.setdefault(one.against, one)
    return tuple(found.values())


def _paid_log_e_value(model: Model, sessions: Sequence[PreparedSession], name: str,
                      run: Run) -> float:
    """The e-value of an effect that was the best of the library: each could have been it."""
    return log_e_value(model, sessions, name, run) - float(np.log(len(EFFECTS)))


def _suggestions(found: Sequence[CandidateFit], sessions: Sequence[PreparedSession],
                 run: Run = serially) -> list[_Assessment]:
    """The best of what is too weak for a model that has none yet, or seen from one side only."""
    likely = [c for c in found if c.p_value * len(found) < SUGGESTED]
    if not likely:
        return []
    # The flank of a spot could stand in for anything smooth.
    first = likely[0]
    best = next((c for c in likely if c.shape_seen and not clearly_better(first, c)), first)
    rivals = [c for c in found if c is not best and _close(c, best)]
    gain = _paid_log_e_value(best.fit.model, sessions, best.id, run)
    return [_Assessment(best, gain, False, False, rivals, [])]


def _close(rival: CandidateFit, own: CandidateFit) -> bool:
    """Whether a rival that is worth a name explains about as much, as BIC or likelihood has it.

    The flank of a wide spot explains whatever a drift does: it has to explain it by less.
    """
    return rival.p_value < FORWARD and (rival.shape_seen or not clearly_better(own, rival)) and (
        rival.delta_bic > own.delta_bic - CLOSE
        or rival.likelihood_ratio > own.likelihood_ratio - CLOSE)


def _not_thermal(fit: ModelFit) -> list[str]:
    """What D of each session does not agree with."""
    return [f'{p.session.name}: {one}.' for p in fit.session_fits
            for one in implausible_diffusion(p.session.conditions, p.noise())]


def _confounded(fit: ModelFit) -> list[str]:
    """What φ can't be told from under the commands."""
    evidence = FitEvidence(fit)
    late = [name for name, effect in EFFECTS.items() if effect.absorbed_by_phi(evidence)]
    if not late:
        return []
    return [f'φ can’t be told from {" or ".join(late)} under this command, which turns one way '
            'only: turn both ways, or in steps.']


def _deviations(fit: ModelFit, name: str) -> list[tuple[Parameter, float, float]]:
    """The parameters of an effect with value and standard deviation in fit coordinates."""
    std = np.sqrt(np.diag(fit.covariance))
    return [
        (parameter, float(x), float(s))
        for (effect, parameter), x, s in zip(
            fit.model.parameters, fit.model.vector(), std, strict=True)
        if effect == name
    ]


def _limits(found: CandidateFit) -> list[Limit]:
    """How large the strengths of an effect that is not supported may still be."""
    limits = []
    for parameter, x, std in _deviations(found.fit, found.id):
        if not parameter.shape:
            most = abs(x) + ONE_SIDED * std
            inside = most <= max(map(abs, parameter.fit_bounds))
            limits.append(Limit(
                found.id, parameter, parameter.from_fit(most) if inside else float('nan')))
    return limits


def _particle_parameters(fit: ModelFit) -> ParticleParameters:
    """The particles of the last session."""
    last = fit.session_fits[-1]
    main = last.session.main
    return ParticleParameters.from_velocity_phasor(
        last.session.ids[main], last.velocity_phasor[main])

