"""What may be said of a rig: which effects are named, and whether something has no name.

An effect is named by its Bayes factor, over the whole library, and against each rival; something
has no name where a map of the residual fires, or a learned term is likelier than the names. The
same rules judge a recording and every look of a search that drives a rig. A ratio of predictive
densities may be looked at as often as one likes, but v, φ and D are fitted anew at every look, so
that no theorem holds here: how often a name is false is known from simulations alone
(docs/explanation/discovery.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

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
from microbot_ros.model.effects import EFFECTS

BETTER = 2.0
"""Log p by which a map has to explain more than an effect, to put it in doubt."""

SMALL = 0.02
"""Part of the evidence for a named effect up to which what is left does not call it into question:
its prediction then errs by √0.02, a seventh, of what it errs by without the effect."""


def enough() -> float:
    """Log evidence from which an effect is named: the chance FALSE, over the whole library."""
    return likelier_than_not() - float(np.log(FALSE))


@dataclass(frozen=True)
class Judgement:
    """What is known after a look.

    `named` effects, and of these the rivals that are still open, `open`; `pending`: effects that
    are in the model or may join it, but are not named yet; `left`: what no effect explains, the
    worst first; `beside`: what is left too, but decides nothing: steps that were cut out, and what
    is small beside a named effect; `unlisted`: whether a term was learned that shows what is left;
    `early`: names that had not the time yet to show that they are the same everywhere, or all
    along; `of_instrument`: effects of the model that are too small to be told from an error of
    camera, time stamps or coils (`Effect.below_floor`); `maps`: all of what the model leaves.
    """

    named: tuple[str, ...]
    open: dict[str, tuple[str, ...]]
    pending: tuple[str, ...]
    left: tuple[ResidualMap, ...]
    beside: tuple[ResidualMap, ...] = ()
    unlisted: bool = False
    early: tuple[str, ...] = ()
    of_instrument: tuple[str, ...] = ()
    maps: tuple[ResidualMap, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether all names are alone, complete and nothing is left."""
        alone = bool(self.named) and not any(self.open.values())
        return alone and not self.pending and not self.left and not self.early

    @property
    def verdict(self) -> Verdict:
        """In one word."""
        return 'unnamed' if self.left else 'named' if self.named else 'consistent'

    def status(self, name: str) -> Status:
        """How sure an effect `name` of the model is."""
        if self.left:
            return 'proxy'
        return 'established' if name in self.named else 'suggested'

    def foretelling_nothing(self) -> Judgement:
        """Where what is left, in maps or as a learned term, foretells nothing of other rows.

        Names then need not explain it: it stands beside them. But for a rhythm, which no term that
        is learned could show.
        """
        rhythm = tuple(m for m in self.left if m.against.startswith('rhythm'))
        beside = tuple(m for m in self.left if m not in rhythm)
        return replace(self, left=rhythm, beside=(*beside, *self.beside), unlisted=False)

    @property
    def answered(self) -> bool:
        """Whether it is settled, or known to be in no list."""
        return self.settled or self.unlisted


def judge(known: Hypotheses, run: Run = serially) -> Judgement:
    """What follows from what is `known`; `run` shares the maps."""
    small = tuple(effect.id for effect in known.fit.model.effects if effect.below_floor())
    named = tuple(slot.own.id for slot in _likely(known)
                  if slot.own.found.shape_seen and slot.own.id not in small)
    times = max((p.session.times for p in known.fit.session_fits), key=np.ptp)
    early = tuple(name for name in named if np.ptp(times) < EFFECTS[name].lookalike_time)
    open_ = {slot.own.id: tuple(one.id for one in slot.within_reach)
             for slot in known.slots if slot.own.id in named}
    pending = [name for name in known.names if name not in (*named, *small)]
    pending += [one.id for one in known.more if one.evidence > likelier_than_not()]
    maps = residual_maps(known.fit, run)
    left, beside = _left(known, named, maps, run)
    return Judgement(named, open_, tuple(pending), left, beside, False, early, small, maps)


def _likely(known: Hypotheses) -> list[Slot]:
    """The effects of the model whose evidence is enough for a name."""
    return [slot for slot in known.slots if slot.own.evidence >= enough()]


def _left(known: Hypotheses, named: Sequence[str], maps: Sequence[ResidualMap],
          run: Run) -> tuple[tuple[ResidualMap, ...], tuple[ResidualMap, ...]]:
    """Of the `maps` those that fire beside the model, and what explains more than an effect of it.

    First those that keep a name back, then those that do not: what was cut out of the fit, what
    hardly moves a particle (`ResidualMap.decides`), and all that fire beside the model where the
    worst of them is small beside a named effect.
    """
    left = [m for m in maps if m.decides]
    beside = [m for m in maps if m.fires and not m.decides]
    worst = max(left, key=_excess, default=None)
    doubts, small = [], False
    for slot in _likely(known):
        alone = residual_maps(slot.rest, run)
        most = slot.own.found.log_p + likelier_than_not() - BETTER
        doubts += [m for m in alone if m.decides and m.log_p < most]
        small |= bool(worst and slot.own.id in named and _is_small(worst, slot.own, alone))
    if small:
        left, beside = [], left + beside
    return _by_chance(left + doubts), _by_chance(beside)


def _is_small(worst: ResidualMap, own: Candidate, without_it: Sequence[ResidualMap]) -> bool:
    """Whether the `worst` of what is left is small beside an effect, and of another kind.

    What only stands in for something else explains less of it, and leaves more of the same, in
    the map that shows most where the effect is left out.
    """
    return worst.against != max(without_it, key=_excess).against and (
        _excess(worst) < SMALL * own.found.likelihood_ratio)


def _excess(found: ResidualMap) -> float:
    """Evidence in a map beyond what chance gives."""
    return found.statistic - found.dof


def _by_chance(maps: Sequence[ResidualMap]) -> tuple[ResidualMap, ...]:
    """The least likely by chance first."""
    return tuple(sorted(maps, key=lambda m: m.p_value))


def scrutinised(known: Hypotheses, judgement: Judgement,
                report: Callable[[str], None] = lambda _: None) -> Judgement:
    """The `judgement` on what is `known` once a term was looked for that no name explains.

    `report` is told what is being done. A term is looked for beside the model, and in place of its
    fields of place together. The evidence of a term is a Bayes factor like that of a name, and
    pays for all that were looked at; maps see less of what is spread over time and place. What is
    surely there, but in a shape that was not seen, has no name either: the flank of a spot beside
    a flow may be any field of place.
    """
    if found := _in_place_of_fields(known, report):
        return replace(judgement, left=(_as_map(found), *judgement.left), unlisted=True)
    if found := known.term_beside(known.fit, report):
        shown = max((slot.own.found.likelihood_ratio for slot in known.slots
                     if slot.own.id in judgement.named), default=0.0)
        if not judgement.left and 2 * found.gain < SMALL * shown:
            return replace(judgement, beside=(_as_map(found), *judgement.beside))
        return replace(judgement, left=(_as_map(found), *judgement.left), unlisted=True)
    unseen = [_in_no_shape(slot.own) for slot in _likely(known)
              if not slot.own.found.shape_seen]
    return replace(judgement, left=(*judgement.left, *unseen))


def _in_place_of_fields(known: Hypotheses, report: Callable[[str], None]) -> Finding | None:
    """A field of place in no list that is likelier than all that are in the model together.

    Each of which pays for the library, as the term does for all that were looked at. A drift, a
    flow and a spot are a series for any field, and pass one by one.
    """
    kinds = {slot.own.id: EFFECTS[slot.own.id] for slot in known.slots}
    fields = [slot.own for slot in known.slots
              if kinds[slot.own.id].overrides('drift') and kinds[slot.own.id].time_invariant]
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
    # Both with the noise at its maximum: at that of the term the rest looks too bad.
    gained = with_term(rest, found.term).log_likelihood - rest.log_likelihood
    evidence = found.log_evidence - found.gain + gained
    return found if evidence > together - len(fields) * likelier_than_not() + RIVAL else None


def _in_no_shape(one: Candidate) -> ResidualMap:
    """What an effect explains whose shape was not seen, as something that is left."""
    against = 'position' if EFFECTS[one.id].needs_position else 'time'
    return ResidualMap(against, against, one.found.likelihood_ratio, one.found.dof,
                       len(EFFECTS) * float(np.exp(-one.evidence)), np.empty(0), {})


def _as_map(found: Finding) -> ResidualMap:
    """What was `found` as something that is left: the inverse of its odds bounds a p-value."""
    term = found.term
    frame = '' if term.frame == 'laboratory' else f', {FRAMES[term.frame]}'
    return ResidualMap(f'{term.against}{frame}', term.against, 2 * found.gain, 0,
                       float(np.exp(-found.log_evidence)), np.empty(0), {})
