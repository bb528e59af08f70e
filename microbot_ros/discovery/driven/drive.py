"""The loop: play, look, ask, play again, until the question is settled, or cannot be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.driven.design import Design, Range, choose_plan, random_steps
from microbot_ros.discovery.driven.joined import join
from microbot_ros.discovery.driven.plan import Plan
from microbot_ros.discovery.driven.questions import (
    hopeless,
    likeliest,
    questions,
    search,
    twins,
)
from microbot_ros.discovery.hypotheses import Hypotheses, consider
from microbot_ros.discovery.report.words import words
from microbot_ros.discovery.verdict import Judgement, judge, scrutinised

Decided = Literal['settled', 'undecidable', 'out_of_time', 'stopped']

BRIEF, LONG, GROWTH = 10.0, 20.0, 8.0
"""Seconds that an experiment takes at first and at most, and how many times as long as one all
before it have lasted: a look tells as much more as there is more to look at."""

SHORTEST = 10.0
"""Seconds left for which another one is not begun."""

THOUGHT = 2.0
"""Seconds from the end of one experiment to the beginning of the next, about."""

HINTS = 120.0
"""Seconds in which, until there is a name, plans only follow what is likeliest; then they go for
what has not shown, too."""

SCRUTINY = 300.0
"""Seconds before which no name is final: what is in no list needs time to show beside it."""

UNEXPLAINED = 44.0
"""Seconds for which something is left at every look, for it to be in no list."""


@dataclass(frozen=True)
class Played:
    """An experiment as it was recorded, and why it was broken off, `stopped`; '' where it was not.
    """

    session: Session
    stopped: str = ''


class Rig(Protocol):
    """What is driven: a rig, or a simulated one."""

    @property
    def limits(self) -> Range:
        """What it can be asked for."""

    @property
    def seconds(self) -> float:
        """Since the first experiment began."""

    def play(self, plan: Plan) -> Played:
        """Play a `plan` to its end, and record it."""


@dataclass(frozen=True)
class Insight:
    """What follows from all experiments so far: `known` hypotheses, and the `judgement` on them.
    """

    known: Hypotheses
    judgement: Judgement

    @property
    def question(self) -> str:
        """What is open, as it is asked."""
        judgement = self.judgement
        for slot in self.known.slots:
            rivals = judgement.open.get(slot.own.id, tuple(
                one.id for one in slot.rivals[:2] if one.evidence > 0))
            if rivals:
                return ' or '.join(words(n) for n in (slot.own.id, *rivals[:2])) + '?'
            if slot.own.id not in judgement.named:
                return f'{words(slot.own.id)} or chance?'
        if judgement.left:
            return f'something that depends on {judgement.left[0].against}?'
        if judgement.early:
            return f'{words(judgement.early[0])}, the same at every place and time?'
        beside = ' too' if self.known.slots else ''
        return f'{words(judgement.pending[0])}{beside}?' if judgement.pending else (
            'anything else?' if self.known.slots else 'anything?')


@dataclass(frozen=True)
class Look:
    """A look after an experiment, `seconds` since the first began.

    Its `plan` in words; why it was broken off, `stopped`, '' where it was not; the `judgement`,
    None where there was not enough to look at; the probability of each effect, and of none (''),
    `odds`, empty where nothing is known; how much longer random steps would have taken for what
    was expected of it, `saved` [s]. It holds no fits: those of many looks are gigabytes.
    """

    plan: str
    stopped: str
    seconds: float
    judgement: Judgement | None
    odds: dict[str, float]
    saved: float = 0.0


@dataclass
class Driven:
    """All that was driven and seen: `experiments`, with a look after each, and how it ended.

    `insight`: the last there was, None where there was none; `decided` and, where it was stopped,
    the `reason`; `twins`: pairs of effects that no command tells apart.
    """

    experiments: list[Session] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)
    insight: Insight | None = None
    decided: Decided = 'out_of_time'
    reason: str = ''
    twins: tuple[tuple[str, str], ...] = ()

    @property
    def seconds(self) -> float:
        """From the beginning of the first experiment to the end of the last."""
        return self.looks[-1].seconds if self.looks else 0.0

    @property
    def named_after(self) -> float | None:
        """Seconds after which the names of the end were there, and alone, for good; None: never.
        """
        since = None
        for look in reversed(self.looks):
            if not (look.judgement and self.insight and look.judgement.settled
                    and look.judgement.named == self.insight.judgement.named):
                break
            since = look.seconds
        return since


Designer = Callable[..., Design]


def lasting(seconds: float) -> float:
    """How long the next experiment takes [s], so many `seconds` after the first began."""
    return min(max(seconds / GROWTH, BRIEF), LONG)


def drive(rig: Rig, minutes: float, report: Callable[[str], None] = lambda _: None,
          seed: int = 0, designer: Designer = choose_plan) -> Driven:
    """Drive a `rig` for as many `minutes` at most, until what is missing is settled.

    `report` is told each step in a sentence; `seed` decides what is drawn. `designer` has the
    signature of `choose_plan`. What stops a rig ends it with what was learned so far.
    """
    result, rng = Driven(), np.random.default_rng(seed)
    plan: Plan | None = random_steps(rng, min(BRIEF, 60 * minutes), rig.limits)
    question, saved = 'looking around:', 0.0
    while plan is not None:
        report(f'{question} {plan.sentence()}')
        played = rig.play(plan)
        if len(played.session.tracks.t):
            result.experiments.append(played.session)
        insight = _look(result)
        left = 60 * minutes - rig.seconds
        final = left < SHORTEST or bool(
            insight and insight.judgement.settled and rig.seconds >= SCRUTINY)
        if insight and final and not played.stopped:
            report('repeating the search, also for effects without a name')
            insight = _look(result, last=True)
            final = left < SHORTEST or bool(insight and insight.judgement.answered)
        result.insight = insight or result.insight
        result.looks.append(Look(
            plan.sentence(), played.stopped, rig.seconds, insight.judgement if insight else None,
            insight.known.odds() if insight else {}, saved))
        if odds := result.looks[-1].odds:
            report(_in_words(odds))
        plan = None
        if played.stopped:
            result.decided, result.reason = 'stopped', played.stopped
        elif _unexplained(result) or (insight and final and insight.judgement.answered):
            result.decided = 'settled'
        elif not final:
            plan, saved = _next(result, insight, left, rig.limits, rng, designer)
            question = insight.question if insight else 'no result yet:'
    return result


def _in_words(odds: Mapping[str, float]) -> str:
    """The four explanations of the highest probability in `odds`, in a line."""
    ranked = sorted(odds.items(), key=lambda one: -one[1])[:4]
    return 'likeliest: ' + ', '.join(
        f'{name.replace("_", " ") or "nothing"} {share:.1%}' for name, share in ranked)


def _look(result: Driven, last: bool = False) -> Insight | None:
    """Return what follows from all experiments together; None where they are not enough.

    The search goes on from the effects of the look before. The `last` look is the search of
    `discover`: from no effect on, and for a term that no name explains.
    """
    before = None if last else result.insight
    try:
        prepared, _ = check_sessions([join(result.experiments)])
    except (InputError, ValueError):
        return None
    known = consider(prepared, before.known.names if before else ())
    judgement = judge(known)
    return Insight(known, scrutinised(known, judgement) if last else judgement)


def _unexplained(result: Driven) -> bool:
    """Whether something has been left for so long that it is in no list."""
    since = result.seconds
    for look in reversed(result.looks):
        if not (look.judgement and look.judgement.left):
            break
        since = look.seconds
    return result.seconds - since >= UNEXPLAINED


def _next(result: Driven, insight: Insight | None, left: float, limits: Range,
          rng: np.random.Generator, designer: Designer) -> tuple[Plan | None, float]:
    """The next plan while so many seconds are `left`, None where there is no use in one; and the
    seconds that it saves."""
    duration = min(lasting(result.seconds), left)
    if insight is None:
        return random_steps(rng, duration, limits), 0.0
    known = insight.known
    hints = result.seconds < HINTS and not insight.judgement.named
    asked = likeliest(known) if hints else questions(known)
    begin = float(known.fit.session_fits[0].session.times[-1]) + THOUGHT
    try:
        design = designer(known.fit, asked, None if hints else search(known), begin, duration,
                          limits, rng)
    except ValueError as error:
        result.decided, result.reason = 'stopped', str(error)
        return None, 0.0
    result.twins = twins(known, insight.judgement, hopeless(
        asked, design, result.seconds + left))
    if result.twins:
        result.decided = 'undecidable'
        return None, 0.0
    return design.plan, duration * (max(design.worth, 1.0) - 1)
