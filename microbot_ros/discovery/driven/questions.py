"""What is to be asked next of a rig, and when no command can settle it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.special import softmax

from microbot_ros.discovery.driven.design import Design, Question, Search
from microbot_ros.discovery.hypotheses import RIVAL, Hypotheses, Slot
from microbot_ros.discovery.verdict import Judgement, enough

CREDIBLE = 1.0
"""Log evidence from which what could be there, beside or in place, is asked for."""

HOPELESS = 0.5
"""Log odds that a search as long as this must bring at least, for a question to be of use."""

ASKED = 4
"""Rivals of an effect, and effects beside, that are asked for at a time."""

LIKELIEST = 5
"""Explanations, nothing among them, that are told apart before anything is named."""


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
    rivals = [one for one in slot.within_reach if one.evidence > CREDIBLE]
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
