"""Loop of experiment, look and next question, until the question is settled or cannot be."""

from __future__ import annotations

from collections.abc import Callable
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
"""How a search ended."""

BRIEF, LONG, GROWTH = 10.0, 20.0, 8.0
"""Shortest and longest duration [s] of an experiment (`LONG`), and the ratio (`GROWTH`) of the
time so far to the duration of the next one.

Each look then has 1/8 more data than the one before. Measured: with experiments of 10 s the first
name came after 1.8 min instead of 2.2 on seven worlds (docs/decisions/asking.md). Shorter ones
spend more of their time on looks, longer ones follow an outdated plan."""

SHORTEST = 10.0
"""Remaining time [s] below which no experiment begins: that of the first, BRIEF."""

THOUGHT = 2.0
"""Expected time [s] between two experiments. Choice: about what a look takes on a laptop."""

HINTS = 120.0
"""Time [s] for which plans follow only the likeliest explanations until one is named.

Measured: such plans had the first name after 1.2 min instead of 1.9 on twelve worlds
(docs/decisions/asking.md). After it plans also look for effects that have not shown.
"""

SCRUTINY = 300.0
"""Time [s] before which no name is final: a cause in no list needs time to show beside it.

Choice: a shorter time names more proxies of unlisted causes, a longer one delays every result.
"""

UNEXPLAINED = 44.0
"""Time [s] for which every look must leave a residual until its cause is in no list.

Choice: two to four looks, in which an effect of the library would have joined the model.
"""


@dataclass(frozen=True)
class Played:
    """A recorded `session` of an experiment, and why it was `stopped`; '' if it was not."""

    session: Session
    stopped: str = ''


class PlanPlayer(Protocol):
    """Protocol of a rig that plays plans, real or simulated."""

    @property
    def limits(self) -> Range:
        """What the rig may be commanded."""

    @property
    def seconds(self) -> float:
        """Time since the first experiment began [s]."""

    def play(self, plan: Plan) -> Played:
        """Play a plan to its end and record it.

        Parameters
        ----------
        plan : Plan
            Fields to play.

        Returns
        -------
        Played
            The recording.
        """


@dataclass(frozen=True)
class Insight:
    """Conclusions from all experiments: hypotheses `known`, and the `judgement` on them."""

    known: Hypotheses
    judgement: Judgement

    @property
    def question(self) -> str:
        """The open question, as a question."""
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
    """Summary of the state of knowledge after an experiment.

    It holds no fits: those of many looks take gigabytes.

    Attributes
    ----------
    plan : str
        The plan in words.
    stopped : str
        Why the experiment was stopped; '' if it was not.
    seconds : float
        Time since the first experiment began [s].
    judgement : Judgement or None
        None for too few data.
    odds : dict of str to float
        Probability of each effect, and of none (''); empty if nothing is known.
    saved : float
        How much longer [s] random steps would have taken for the expected gain.
    """

    plan: str
    stopped: str
    seconds: float
    judgement: Judgement | None
    odds: dict[str, float]
    saved: float = 0.0


@dataclass
class Driven:
    """All experiments of a search, and how it ended.

    Attributes
    ----------
    experiments : list of Session
        Recordings.
    looks : list of Look
        One after each experiment.
    insight : Insight or None
        The last one.
    decided : Decided
        How the search ended.
    reason : str
        Why it was stopped.
    twins : tuple of (str, str)
        Pairs of effects that no command distinguishes.
    """

    experiments: list[Session] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)
    insight: Insight | None = None
    decided: Decided = 'out_of_time'
    reason: str = ''
    twins: tuple[tuple[str, str], ...] = ()

    @property
    def seconds(self) -> float:
        """Time from the start of the first experiment to the end of the last [s]."""
        return self.looks[-1].seconds if self.looks else 0.0

    @property
    def named_after(self) -> float | None:
        """Time [s] after which the final names were settled for good; None for never."""
        since = None
        for look in reversed(self.looks):
            if not (look.judgement and self.insight and look.judgement.settled
                    and look.judgement.named == self.insight.judgement.named):
                break
            since = look.seconds
        return since


Designer = Callable[..., Design]
"""Function with the signature of `choose_plan`."""


def lasting(seconds: float) -> float:
    """Return the duration of the next experiment.

    Parameters
    ----------
    seconds : float
        Time since the first experiment began [s].

    Returns
    -------
    float
        Duration [s], from BRIEF to LONG.
    """
    return min(max(seconds / GROWTH, BRIEF), LONG)


def drive(rig: PlanPlayer, minutes: float, report: Callable[[str], None] = lambda _: None,
          seed: int = 0, designer: Designer = choose_plan,
          looked: Callable[[Look], None] = lambda _: None) -> Driven:
    """Drive a rig until the question of the missing effect is settled.

    Parameters
    ----------
    rig : PlanPlayer
        The rig. If it stops, the search ends with what was learned so far.
    minutes : float
        Time limit [min].
    report : callable, optional
        Receives one sentence for each step.
    seed : int, optional
        Seed of random plans.
    designer : Designer, optional
        Chooses the plans.
    looked : callable, optional
        Receives the summary of each look.

    Returns
    -------
    Driven
        Experiments, looks and ending.
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
        looked(result.looks[-1])
        plan = None
        if played.stopped:
            result.decided, result.reason = 'stopped', played.stopped
        elif _unexplained(result) or (insight and final and insight.judgement.answered):
            result.decided = 'settled'
        elif not final:
            plan, saved = _next(result, insight, left, rig.limits, rng, designer)
            question = insight.question if insight else 'no result yet:'
    return result


def _look(result: Driven, last: bool = False) -> Insight | None:
    """Return the conclusions from all experiments together; None where these are too few.

    The search continues from the effects of the previous look. The `last` look is the search of
    `discover`: from no effect on, and with a search for a learned term.
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
    """Return whether a residual has been left for so long that its cause is in no list."""
    since = result.seconds
    for look in reversed(result.looks):
        if not (look.judgement and look.judgement.left):
            break
        since = look.seconds
    return result.seconds - since >= UNEXPLAINED


def _next(result: Driven, insight: Insight | None, left: float, limits: Range,
          rng: np.random.Generator, designer: Designer) -> tuple[Plan | None, float]:
    """Return the next plan, and the seconds that it saves; None where no plan is useful."""
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
