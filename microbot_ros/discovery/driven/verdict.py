"""When a question is settled, and when no command can settle it.

The evidence for an effect, averaged over the library, is a mixture of likelihood ratios of
predictive densities, each experiment foretold from those before: given v, φ and D as the first
frames leave them it is a nonnegative martingale where the effect is not there, however the
commands are chosen from what was seen. By Ville's inequality (1939) it ever exceeds 1/α with a
chance of α at most, so that it may be looked at after every experiment, and the end may depend on
it (Robbins 1970; Grünwald, de Heide and Koolen 2024). The same holds for the odds of a name
against each rival, with the rival's own parameters averaged over what may be known of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import softmax

from microbot_ros.discovery.driven.design import Design, Question, Search
from microbot_ros.discovery.driven.hypotheses import Candidate, Hypotheses, Slot
from microbot_ros.discovery.learned.learn import Finding, learn_term
from microbot_ros.discovery.result import FRAMES, ResidualMap
from microbot_ros.discovery.score_tests import residual_maps
from microbot_ros.discovery.stepwise_selection import without
from microbot_ros.model.effects import EFFECTS

FALSE = 0.01
"""Chance of a name where nothing is missing, over all looks together."""

RIVAL = float(np.log(1 / FALSE))
"""Log odds against each rival from which a name is alone."""

CREDIBLE = 1.0
"""Log evidence from which what could be there, beside or in place, is asked for."""

HOPELESS = 0.5
"""Log odds that a search as long as this must bring at least, for a question to be of use."""

ASKED = 4
"""Rivals of an effect, and effects beside, that are asked for at a time."""

LIKELIEST = 5
"""Explanations, nothing among them, that are told apart before anything is named."""

LOOKALIKE = dict.fromkeys(('uniform_drift', 'linear_flow', 'hot_spot'), 210.0) | {
    'speed_decay': 54.0}
"""Seconds for which a field of place or a change in time that no name has may look like these:
particles must have been elsewhere, or some time must have gone by, for the difference to show."""

BETTER = 2.0
"""Log p by which a map has to explain more than an effect, to put it in doubt."""


def enough() -> float:
    """Log evidence from which an effect is named: the chance FALSE, over the whole library."""
    return float(np.log(len(EFFECTS) / FALSE))


def likelier_than_not() -> float:
    """Log evidence from which an effect, any of the library, is rather there than not."""
    return float(np.log(len(EFFECTS)))


@dataclass(frozen=True)
class Judgement:
    """What is known after a look.

    `named` effects, and of these the rivals that are still open, `open`; `pending`: effects that
    are in the model or may join it, but are not named yet; `left`: what no effect explains, the
    worst first; `unlisted`: whether a term was learned that shows it; `early`: names that had not
    the time yet to show that they are the same everywhere, or all along.
    """

    named: tuple[str, ...]
    open: dict[str, tuple[str, ...]]
    pending: tuple[str, ...]
    left: tuple[ResidualMap, ...]
    unlisted: bool = False
    early: tuple[str, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether all names are alone, complete and nothing is left."""
        alone = bool(self.named) and not any(self.open.values())
        return alone and not self.pending and not self.left and not self.early

    @property
    def answered(self) -> bool:
        """Whether it is settled, or known to be in no list."""
        return self.settled or self.unlisted


def judge(known: Hypotheses) -> Judgement:
    """What follows from what is `known`."""
    named = tuple(slot.own.id for slot in known.slots
                  if slot.own.evidence >= enough() and slot.own.found.shape_seen)
    open_ = {slot.own.id: tuple(r.id for r in slot.rivals if slot.behind(r) < RIVAL)
             for slot in known.slots if slot.own.id in named}
    pending = [slot.own.id for slot in known.slots if slot.own.id not in named]
    pending += [one.id for one in known.more if one.evidence > likelier_than_not()]
    return Judgement(named, open_, tuple(pending), _left(known),
                     early=too_early(named, known.fit.session_fits[0].session.times))


def too_early(named: Sequence[str], times: np.ndarray) -> tuple[str, ...]:
    """Of the names `named` those that what is in no list may look like for longer than all frames
    last, whose `times` (T,) [s] these are."""
    return tuple(name for name in named if np.ptp(times) < LOOKALIKE.get(name, 0.0))


def _left(known: Hypotheses) -> tuple[ResidualMap, ...]:
    """Maps that fire beside the model, or explain more than an effect of it does.

    They only ever keep a name back, so that looking again makes no name likelier.
    """
    maps = [m for m in residual_maps(known.fit) if m.fires]
    for slot in known.slots:
        if slot.own.evidence >= enough():
            most = slot.own.found.log_p + np.log(len(EFFECTS)) - BETTER
            maps += [m for m in residual_maps(slot.rest)
                     if m.fires and not m.cut_out and m.log_p < most]
    return tuple(sorted(maps, key=lambda m: m.p_value))


def scrutinised(known: Hypotheses, judgement: Judgement) -> Judgement:
    """The `judgement` on what is `known` once a term was looked for that no name explains.

    Beside the model, and in place of its fields of place together. The evidence of a term is a
    Bayes factor like that of a name, and pays for all that were looked at; maps see less of what
    is spread over time and place. What is surely there, but in a shape that was not seen, has no
    name either: the flank of a spot beside a flow may be any field of place.
    """
    found = _in_place_of_fields(known) or learn_term(known.fit)
    if found is not None:
        return replace(judgement, left=(_as_map(found), *judgement.left), unlisted=True)
    unseen = [_in_no_shape(slot.own) for slot in known.slots
              if slot.own.evidence >= enough() and not slot.own.found.shape_seen]
    return replace(judgement, left=(*judgement.left, *unseen))


def _in_place_of_fields(known: Hypotheses) -> Finding | None:
    """A field of place in no list that is likelier than all that are in the model together.

    Each of which pays for the library, as the term does for all that were looked at. A drift, a
    flow and a spot are a series for any field, and pass one by one.
    """
    rest, together = known.fit, 0.0
    for slot in known.slots:
        kind = EFFECTS[slot.own.id]
        if kind.overrides('drift') and kind.time_invariant:
            rest = without(rest, slot.own.id)
            together += slot.own.evidence - likelier_than_not()
    found = None if rest is known.fit else learn_term(rest)
    if found and found.term.against == 'position' and found.log_evidence > together + RIVAL:
        return found
    return None


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


def questions(known: Hypotheses) -> list[Question]:
    """What is to be told apart next, the present model's own rivals first."""
    asked = []
    for slot in known.slots:
        asked += _of_slot(known, slot)
    shown = [one for one in known.more if one.evidence > CREDIBLE][:ASKED]
    odds = known.odds()
    asked += [Question(one.found.fit, known.fit, enough() - one.evidence, odds.get(one.id, 0.1))
              for one in shown]
    if not known.slots:
        asked += [Question(first.found.fit, second.found.fit,
                           max(RIVAL - first.evidence + second.evidence, 1.0), odds[second.id])
                  for k, first in enumerate(shown) for second in shown[k + 1:]]
    return asked


def likeliest(known: Hypotheses) -> list[Question]:
    """What is to be told apart before anything is named: the likeliest that may be in the place
    that is open, nothing among them, pair by pair, weighed by the odds of both.

    At the strength that each would have if it were there, however weak the sign of it is.
    """
    slot = known.slots[-1] if known.slots else None
    some = (slot.own, *slot.rivals) if slot else known.more
    fits = [slot.rest if slot else known.fit, *(one.found.fit for one in some)]
    odds = softmax([0.0, *(one.evidence for one in some)])
    best = np.argsort(-odds, kind='stable')[:LIKELIEST]
    return [Question(fits[i], fits[j], RIVAL, float(odds[i] * odds[j]))
            for i, j in combinations(best, 2)]


def search(known: Hypotheses) -> Search:
    """What has not shown yet, and may."""
    odds = known.odds()
    share = 1.0 if not known.slots else 0.2 / max(len(known.more), 1)
    return Search({one.id: odds.get(one.id, 0.0) if not known.slots else share
                   for one in known.more if one.evidence <= CREDIBLE}, enough())


def _of_slot(known: Hypotheses, slot: Slot) -> list[Question]:
    asked = []
    if slot.own.evidence < enough():
        asked.append(Question(known.fit, slot.rest, enough() - slot.own.evidence))
    rivals = [one for one in slot.rivals
              if slot.behind(one) < RIVAL and one.evidence > CREDIBLE]
    return asked + [Question(known.fit, one.found.fit, RIVAL - slot.behind(one))
                    for one in rivals[:ASKED]]


def hopeless(asked: Sequence[Question], design: Design, seconds: float) -> list[Question]:
    """Which of the questions `asked` no plan that was tried would help in a search of `seconds`.

    Of the whole search, not of what is left of it: that time runs out is no word about a rig.
    """
    reach = design.best * seconds / design.plan.duration
    return [question for question, gain in zip(asked, reach, strict=True) if gain < HOPELESS]


def twins(known: Hypotheses, judgement: Judgement,
          beyond: Sequence[Question]) -> tuple[tuple[str, str], ...]:
    """Pairs of a named effect and a rival that nothing tells apart.

    () while anything else is open: what is `beyond` reach must be all that is left to ask.
    """
    if judgement.left or judgement.pending or not judgement.named:
        return ()
    fits = {id(question.second) for question in beyond}
    pairs = tuple((slot.own.id, rival.id) for slot in known.slots for rival in slot.rivals
                  if id(rival.found.fit) in fits)
    return pairs if len(pairs) == sum(map(len, judgement.open.values())) else ()
