"""Rules of the verdict: which effects are named, and whether something remains without a name.

An effect is named by its Bayes factor, corrected for the whole library, and against each rival. An
unnamed effect exists where a residual map shows structure, or a learned term is likelier than the
named effects. The same rules judge a recording and every evaluation of a search that drives a rig.
A ratio of predictive densities may be evaluated any number of times. Here v, φ and D are refitted
at every evaluation, so that theorem does not apply: the rate of false names is known from
simulations only (docs/explanation/discovery.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.discovery.check.halves import CONTRADICTED, foretold
from microbot_ros.discovery.check.score_tests import residual_maps
from microbot_ros.discovery.hypotheses import (
    FALSE,
    RIVAL,
    Candidate,
    Hypotheses,
    Slot,
    joint_log_bayes_factor,
    likelier_than_not,
)
from microbot_ros.discovery.learned.learn import Finding, with_term
from microbot_ros.discovery.processes import Run, serially
from microbot_ros.discovery.result import FRAMES, ResidualMap, Status, Verdict
from microbot_ros.discovery.search import without
from microbot_ros.model.effect import Effect
from microbot_ros.model.effects import EFFECTS

BETTER = 2.0
"""Difference of log p by which a map must explain more than an effect to put it in doubt.

Choice: a smaller value doubts effects that a map of many curves mimics, a larger one keeps wrong
names.
"""

SMALL = 0.02
"""Fraction of the evidence for a named effect up to which a residual does not question it.

Choice: the prediction then errs by √0.02, a seventh, of its error without the effect.
"""


def enough() -> float:
    """Return the log Bayes factor above which an effect is named.

    Returns
    -------
    float
        Such that the probability of a false name is FALSE, over the whole library.
    """
    return likelier_than_not() - float(np.log(FALSE))


@dataclass(frozen=True)
class Judgement:
    """State of knowledge after an evaluation.

    Attributes
    ----------
    named : tuple of str
        Effects that are named.
    open : dict of str to tuple of str
        For each named effect the rivals that are not excluded.
    pending : tuple of str
        Effects that are in the model, or may join it, without a name yet.
    left : tuple of ResidualMap
        What no effect explains, smallest p-value first.
    beside : tuple of ResidualMap
        Residuals that decide nothing: steps excluded from the fit, and what is small beside a
        named effect.
    unlisted : bool
        Whether a learned term shows what is left.
    early : tuple of str
        Named effects recorded for too short a time to show that they are the same everywhere, or
        all the time.
    of_instrument : tuple of str
        Effects of the model too small to be told from an error of camera, time stamps or coils
        (`Effect.below_floor`).
    contradicted : tuple of str
        Effects of the model that one half of the recordings foretells wrongly for the other half.
    doubted : tuple of str
        Effects of the model that may stand in for another cause: without them a residual map
        explains more than they do, or a learned field takes their place, or the shape of one of
        them was not seen, or they are `contradicted`.
    maps : tuple of ResidualMap
        All residual maps of the model.
    """

    named: tuple[str, ...]
    open: dict[str, tuple[str, ...]]
    pending: tuple[str, ...]
    left: tuple[ResidualMap, ...]
    beside: tuple[ResidualMap, ...] = ()
    unlisted: bool = False
    early: tuple[str, ...] = ()
    of_instrument: tuple[str, ...] = ()
    contradicted: tuple[str, ...] = ()
    doubted: tuple[str, ...] = ()
    maps: tuple[ResidualMap, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether effects are named and nothing is open, pending, left or too short."""
        alone = bool(self.named) and not any(self.open.values())
        return alone and not self.pending and not self.left and not self.early

    @property
    def verdict(self) -> Verdict:
        """The verdict in one word."""
        return 'unnamed' if self.left else 'named' if self.named else 'consistent'

    def status(self, name: str) -> Status:
        """Return how certain an effect of the model is.

        Parameters
        ----------
        name : str
            Id of the effect.

        Returns
        -------
        Status
            `proxy` if something is left; else `established` if it is named, or `suggested`.
        """
        if self.left:
            return 'proxy'
        return 'established' if name in self.named else 'suggested'

    def foretelling_nothing(self) -> Judgement:
        """Return the judgement for residuals that do not improve prediction on held-out rows.

        Named effects then need not explain the residuals, which move to `beside`. Those in doubt
        lose their names. A rhythm stays in `left`: no learned term could show it, and it is there
        only if it moves particles (`ResidualMap.decides`).

        Returns
        -------
        Judgement
            With `unlisted` False.
        """
        rhythm = tuple(m for m in self.left if m.against.startswith('rhythm'))
        beside = tuple(m for m in self.left if m not in rhythm)
        named = tuple(name for name in self.named if name not in self.doubted)
        return replace(self, named=named, left=rhythm, beside=(*beside, *self.beside),
                       unlisted=False)

    def rests_on_doubt(self, known: Hypotheses) -> bool:
        """Return whether the effect that explains most is in doubt.

        Parameters
        ----------
        known : Hypotheses
            Models that may explain the data.

        Returns
        -------
        bool
            False without effects.
        """
        most = max(known.slots, key=lambda slot: slot.own.found.likelihood_ratio, default=None)
        return most is not None and most.own.id in self.doubted

    @property
    def answered(self) -> bool:
        """Whether the judgement is settled, or the cause is known to be in no list."""
        return self.settled or self.unlisted


def judge(known: Hypotheses, run: Run = serially) -> Judgement:
    """Apply the rules to the hypotheses.

    Parameters
    ----------
    known : Hypotheses
        Models that may explain the data.
    run : Run, optional
        Distributes the residual maps.

    Returns
    -------
    Judgement
        Before a search for learned terms (`scrutinised`).
    """
    small = tuple(effect.id for effect in known.fit.model.effects if effect.below_floor())
    shown = [slot.own.id for slot in _likely(known)
             if slot.own.found.shape_seen and slot.own.id not in small]
    contradicted = tuple(name for name in shown if foretold(known.fit, name) < CONTRADICTED)
    named = tuple(name for name in shown if name not in contradicted)
    times = max((p.session.times for p in known.fit.session_fits), key=np.ptp)
    early = tuple(name for name in named if np.ptp(times) < EFFECTS[name].lookalike_time)
    open_ = {slot.own.id: tuple(one.id for one in slot.within_reach)
             for slot in known.slots if slot.own.id in named}
    pending = [name for name in known.names if name not in (*named, *small)]
    pending += [one.id for one in known.more if one.evidence > likelier_than_not()]
    maps = residual_maps(known.fit, run)
    left, beside, doubted = _left(known, named, maps, run)
    return Judgement(named, open_, tuple(pending), left, beside, early=early, of_instrument=small,
                     contradicted=contradicted, doubted=(*contradicted, *doubted), maps=maps)


def _likely(known: Hypotheses) -> list[Slot]:
    """Return the effects of the model whose evidence suffices for a name."""
    return [slot for slot in known.slots if slot.own.evidence >= enough()]


def _left(
    known: Hypotheses, named: Sequence[str], maps: Sequence[ResidualMap], run: Run,
) -> tuple[tuple[ResidualMap, ...], tuple[ResidualMap, ...], tuple[str, ...]]:
    """Return the residual maps that prevent a name, those that do not, and effects in doubt.

    The first are maps that decide beside the model, or that explain more than one of its effects.
    The second are what the fit excludes, what hardly moves a particle (`ResidualMap.decides`), and
    all maps with structure where the worst of them is small beside a named effect.
    """
    left = [m for m in maps if m.decides]
    beside = [m for m in maps if m.fires and not m.decides]
    worst = max(left, key=_excess, default=None)
    doubts, doubted, small = [], [], False
    for slot in _likely(known):
        alone = residual_maps(slot.rest, run)
        most = slot.own.found.log_p + likelier_than_not() - BETTER
        better = [m for m in alone if m.decides and m.log_p < most]
        doubts += better
        doubted += [slot.own.id] * bool(better)
        small |= bool(worst and slot.own.id in named and _is_small(worst, slot.own, alone))
    if small:
        left, beside = [], left + beside
    return _by_chance(left + doubts), _by_chance(beside), tuple(doubted)


def _is_small(worst: ResidualMap, own: Candidate, without_it: Sequence[ResidualMap]) -> bool:
    """Return whether the `worst` residual is small beside an effect, and of another kind.

    An effect that only stands in for another cause explains less of it. It then leaves more in the
    same map that shows most without the effect.
    """
    return worst.against != max(without_it, key=_excess).against and (
        _excess(worst) < SMALL * own.found.likelihood_ratio)


def _excess(found: ResidualMap) -> float:
    """Return the χ² of a map beyond its expectation."""
    return found.statistic - found.dof


def _by_chance(maps: Sequence[ResidualMap]) -> tuple[ResidualMap, ...]:
    """Return the maps sorted by p-value."""
    return tuple(sorted(maps, key=lambda m: m.p_value))


def scrutinised(known: Hypotheses, judgement: Judgement,
                report: Callable[[str], None] = lambda _: None) -> Judgement:
    """Search for a learned term that no named effect explains, and update the judgement.

    A term is learned beside the model, and in place of all its effects that depend on place. Its
    evidence is a Bayes factor like that of an effect, less the cost of all terms tried. Residual
    maps are less sensitive to what is spread over time and place. An effect that is certain, but
    whose shape the recording does not show, is not named either: the flank of a spot beside a flow
    may be any field of place.

    Parameters
    ----------
    known : Hypotheses
        Models that may explain the data.
    judgement : Judgement
        From `judge`.
    report : callable, optional
        Receives one line of progress.

    Returns
    -------
    Judgement
        With `left`, `beside`, `doubted` and `unlisted` updated.
    """
    explained = {slot.own.id: slot.own.found.likelihood_ratio for slot in known.slots}
    if found := _in_place_of_fields(known, report):
        return _unlisted(judgement, found, [
            name for name in explained if _is_field(EFFECTS[name])])
    if found := known.term_beside(known.fit, report):
        shown = max((explained[name] for name in judgement.named), default=0.0)
        if not judgement.left and 2 * found.gain < SMALL * shown:
            return replace(judgement, beside=(_as_map(found), *judgement.beside))
        return _unlisted(judgement, found)
    unseen = [slot.own for slot in _likely(known) if not slot.own.found.shape_seen]
    most = max((explained[one.id] for one in unseen), default=0.0)
    any_field = any(_is_field(EFFECTS[one.id]) for one in unseen)
    return replace(judgement, left=(*judgement.left, *map(_in_no_shape, unseen)), doubted=(
        *judgement.doubted, *(name for name, ratio in explained.items() if ratio <= most
                              or (any_field and _is_field(EFFECTS[name])))))


def _unlisted(judgement: Judgement, found: Finding, doubted: Sequence[str] = ()) -> Judgement:
    """Return the judgement with a learned term, which may put effects in doubt."""
    return replace(judgement, left=(_as_map(found), *judgement.left), unlisted=True,
                   doubted=(*judgement.doubted, *doubted))


def _is_field(kind: type[Effect]) -> bool:
    """Return whether an effect is a drift that depends on place, or on nothing."""
    return kind.overrides('drift') and kind.time_invariant


def _in_place_of_fields(known: Hypotheses, report: Callable[[str], None]) -> Finding | None:
    """Return a learned field of place that is likelier than all such effects together.

    Each effect pays for the library, as the term does for all terms tried. A drift, a flow and a
    spot are a series for any field, and pass one by one.
    """
    fields = [slot.own for slot in known.slots if _is_field(EFFECTS[slot.own.id])]
    if not fields:
        return None
    rest = known.start
    if len(fields) < len(known.slots):
        rest = known.fit
        for one in fields:
            rest = without(rest, one.id)
    together = joint_log_bayes_factor(known.fit, rest, [one.found for one in fields])
    found = known.term_beside(rest, report)
    if found is None or found.term.against != 'position':
        return None
    # Each at its own noise: at the noise of the term the rest has too low a likelihood.
    gained = with_term(rest, found.term).log_likelihood - rest.log_likelihood
    evidence = found.log_evidence - found.gain + gained
    return found if evidence > together - len(fields) * likelier_than_not() + RIVAL else None


def _in_no_shape(one: Candidate) -> ResidualMap:
    """Return what an effect explains, whose shape was not seen, as a residual map."""
    against = 'position' if EFFECTS[one.id].needs_position else 'time'
    return ResidualMap(against, against, one.found.likelihood_ratio, one.found.dof,
                       len(EFFECTS) * float(np.exp(-one.evidence)), np.empty(0), {})


def _as_map(found: Finding) -> ResidualMap:
    """Return a learned term as a residual map: the inverse of its odds bounds a p-value."""
    term = found.term
    frame = '' if term.frame == 'laboratory' else f', {FRAMES[term.frame]}'
    return ResidualMap(f'{term.against}{frame}', term.against, 2 * found.gain, 0,
                       float(np.exp(-found.log_evidence)), np.empty(0), {})
