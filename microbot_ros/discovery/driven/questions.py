"""The next questions to a rig, and when no command can settle them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.special import softmax

from microbot_ros.discovery.driven.design import Design, Question, Search
from microbot_ros.discovery.hypotheses import RIVAL, Hypotheses, Slot
from microbot_ros.discovery.verdict import Judgement, enough

CREDIBLE = 1.0
"""Log evidence above which a further effect or a rival becomes a question.

Choice: from 0 on, names came no sooner on 15 worlds (docs/decisions/asking.md); a larger value
asks later.
"""

HOPELESS = 0.5
"""Expected log evidence of a whole search below which a question is hopeless.

Choice: a ninth of what decides between rivals (RIVAL). A larger value gives up questions that a
second search would settle, a smaller one asks in vain.
"""

ASKED = 4
"""Maximum number of rivals of an effect, and of further effects, that are asked about at a time.

Choice: each costs one expected displacement per plan tried.
"""

LIKELIEST = 5
"""Number of explanations, including no effect, that are distinguished before anything is named.

Choice: ten pairs; more cost time, fewer may leave out the true one (docs/decisions/asking.md).
"""


def questions(known: Hypotheses) -> list[Question]:
    """Return the explanations to be distinguished next.

    Parameters
    ----------
    known : Hypotheses
        Models that may explain the data.

    Returns
    -------
    list of Question
        Rivals of the current model first.
    """
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
    """Return the questions before anything is named: the likeliest explanations in pairs.

    They compete for the open slot, no effect among them. Pairs are weighted by the odds of both.
    Each effect has the strength that it would have if present, however weak its evidence is.

    Parameters
    ----------
    known : Hypotheses
        Models that may explain the data.

    Returns
    -------
    list of Question
        Pairs of the LIKELIEST explanations.
    """
    slot = known.slots[-1] if known.slots else None
    some = (slot.own, *slot.rivals) if slot else known.more
    fits = [slot.rest if slot else known.fit, *(one.found.fit for one in some)]
    odds = softmax([0.0, *(one.evidence for one in some)])
    best = np.argsort(-odds, kind='stable')[:LIKELIEST]
    return [Question(fits[i], fits[j], RIVAL, float(odds[i] * odds[j]))
            for i, j in combinations(best, 2)]


def search(known: Hypotheses) -> Search:
    """Return the effects that are not visible yet.

    Parameters
    ----------
    known : Hypotheses
        Models that may explain the data.

    Returns
    -------
    Search
        Their odds, and the evidence for a name.
    """
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
    """Return the questions that no plan would help in a search of this length.

    The length is that of the whole search, not of the remaining time, which says nothing about a
    rig.

    Parameters
    ----------
    asked : sequence of Question
        All questions.
    design : Design
        Chosen plan, with the best gains of all plans tried.
    seconds : float
        Duration of the search [s].

    Returns
    -------
    list of Question
        Questions whose expected gain is below HOPELESS.
    """
    reach = design.best * seconds / design.plan.duration
    return [question for question, gain in zip(asked, reach, strict=True) if gain < HOPELESS]


def twins(known: Hypotheses, judgement: Judgement,
          beyond: Sequence[Question]) -> tuple[tuple[str, str], ...]:
    """Return pairs of a named effect and a rival that no command distinguishes.

    Parameters
    ----------
    known : Hypotheses
        Models that may explain the data.
    judgement : Judgement
        Judgement on them.
    beyond : sequence of Question
        Hopeless questions.

    Returns
    -------
    tuple of (str, str)
        Empty while any other question is open.
    """
    if judgement.left or judgement.pending or not judgement.named:
        return ()
    fits = {id(question.second) for question in beyond}
    pairs = tuple((slot.own.id, rival.id) for slot in known.slots for rival in slot.rivals
                  if id(rival.found.fit) in fits)
    return pairs if len(pairs) == sum(map(len, judgement.open.values())) else ()
