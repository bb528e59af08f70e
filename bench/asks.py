"""The rig asks its own questions: minutes until what is hidden has its name, and wrong names.

Worlds of the fine physics, a camera, a view with edges; the loop without a graph, and with one for
a sample. Every effect is hidden so that a minute of random steps would hold λ = 10 of evidence.
The rivals are random steps judged by the same rules, and the rules of the literature. The worlds
are drawn by seed, and what came of each is in `out/asks.jsonl`: of every kind of run as many as of
any other at any time.

Minutes are compared at the same share of wrong names: all are taken at their first word. A rule of
the literature says at every look what is likeliest, and how sure it is; from how sure on it is
taken at its word is then chosen so that, on the worlds that both have seen, it is wrong no more
often than ours, and no later than that asks for.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench import _asks_graph
from bench._asks_rivals import RULES, Rule, by_rule
from bench._asks_worlds import hidden_world
from bench._driven_rig import SimulatedRig
from bench._hidden_effects import LISTED, UNLISTED
from bench._kept import in_turns, run_kept
from bench.figure import FULL, Figure, sized
from microbot_ros.discovery.driven.design import Design, Question, Range, Search, random_steps
from microbot_ros.discovery.driven.drive import Driven, drive
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.model.effects import EFFECTS

ISSUE = 18
MINUTES, PAIR_MINUTES, OTHER_MINUTES = 6.0, 10.0, 6.0
SEEDS, NULLS = sized(4, 1), sized(200, 12)
RIVAL_NULLS, RIVAL_UNLISTED = sized(20, 2), sized(2, 1)
"""Worlds without anything hidden, and seeds of what is in no list, that rules are tried on."""

PAIRS = (
    ('uniform_drift', 'alignment_lag'), ('background_field', 'command_delay'),
    ('coil_gain_mismatch', 'speed_decay'), ('pixel_anisotropy', 'heading_slip'),
    ('linear_flow', 'command_delay'), ('gradient_force', 'coil_misalignment'),
    ('uniform_drift', 'speed_decay'), ('coil_pull', 'alignment_lag'),
    ('amplifier_deadband', 'uniform_drift'), ('incomplete_alignment', 'heading_slip'))

COVARIATES = {
    'poiseuille_flow': 'position', 'speed_by_place': 'position', 'trap': 'position',
    'pulsing_speed': 'rhythm time', 'heading_wobble': 'rhythm time',
    'speed_by_heading': 'heading command', 'lamp_change': 'time step',
    'settling_flow': 'time', 'stage_jump': 'step time', 'repulsion': 'neighbours',
    'swimmer_flow': 'neighbours'}
"""Words of which one must be in the name of a map that shows what is in no list."""


SETTLED = 99.0
"""How sure ours is where all is settled."""

Case = tuple[str, tuple[str, ...], int]
"""How it is asked, what is hidden, and the seed."""


@dataclasses.dataclass(frozen=True)
class Run:
    """What came of one world: who `asked`, what was `hidden`, what was `named`.

    `minutes` until the names were there, for good and alone; until the end where they never were.
    `course`: after so many minutes, what it said, names with + between, and how sure it was; of
    ours only where all was settled.
    """

    asked: str
    hidden: tuple[str, ...]
    seed: int
    decided: str
    minutes: float
    named: tuple[str, ...]
    open: tuple[str, ...]
    left: tuple[str, ...]
    twins: tuple[tuple[str, str], ...]
    course: tuple[tuple[float, str, float], ...] = ()

    @property
    def world(self) -> tuple[tuple[str, ...], int]:
        """What is the same for all who are asked."""
        return self.hidden, self.seed

    @property
    def right(self) -> bool:
        """Whether exactly what was hidden is named, and nothing else can be it."""
        return (self.decided == 'settled' and set(self.named) == set(self.hidden)
                and not self.open and not self.left)

    @property
    def wrong(self) -> bool:
        """Whether something is established that was not hidden."""
        return bool(set(self.named) - set(self.hidden)) and not self.left and not self.open

    def taken(self, sure: float) -> tuple[float, set[str]]:
        """Its first word, from so `sure` on: after how many minutes, and the names; else the end.
        """
        for minutes, said, odds in self.course:
            if odds >= sure:
                return minutes, set(said.split('+')) - {''}
        return MINUTES, set()


def figures() -> Iterator[Figure]:
    """Every figure of the issue."""
    runs = run_kept(Path('out/asks.jsonl'), every_case(), run, _again)
    yield from score(runs)
    yield _design_seconds()
    if FULL:
        yield from _asks_graph.figures()


def every_case() -> list[Case]:
    """All that is run, kind by kind in turns."""
    kinds = [_effects('asks'), _nulls(), _unlisted(), _pairs(), _twins(),
             _effects('random'), *map(_rival, RULES)]
    return in_turns(kinds)


def _again(told: dict[str, Any]) -> Run:
    """A run from its fields as JSON has them."""
    pairs = {key: tuple(map(tuple, told.pop(key))) for key in ('twins', 'course')}
    return Run(**{key: tuple(value) if isinstance(value, list) else value
                  for key, value in told.items()}, **pairs)


def score(runs: Sequence[Run]) -> list[Figure]:
    """The figures of `runs`, each with its 95 % interval as the peer."""
    of = {kind: [one for one in runs if one.asked == kind] for kind in (
        'asks', 'random', *RULES, 'nothing', 'twins', 'pairs', 'unlisted')}
    share = _share
    names = [one for kind in ('asks', 'twins', 'pairs', 'unlisted') for one in of[kind]]
    result = [
        share('right and unambiguous within 6 min', of['asks'], lambda r: r.right, 0.95),
        share('wrong established name', names, lambda r: r.wrong, 0.01, most=True),
        share('nothing missing: a name at any look', of['nothing'], lambda r: bool(r.named),
              0.01, most=True),
        share('twins told undecidable', of['twins'], lambda r: r.decided == 'undecidable', 0.95),
        share('two at once, right within 10 min', of['pairs'], lambda r: r.right, 0.90),
        share('in no list: told so, covariate right', of['unlisted'], told_unlisted, 0.95)]
    own = [*of['asks'], *of['nothing'], *of['unlisted']]
    result += [_against(peer, target, own, of[peer]) for peer, target in (
        ('random', 0.5), *((rule, 1 / 1.5) for rule in RULES))]
    return [figure for figure in result if math.isfinite(figure.value)]


def _against(peer: str, target: float, runs: Sequence[Run], others: Sequence[Run]) -> Figure:
    """Median minutes to the right name on the worlds that both saw, at a share of wrong names."""
    both = {r.world for r in runs} & {r.world for r in others}
    own = [r for r in runs if r.world in both]
    other = [r for r in others if r.world in both]
    sure = 0.0 if peer == 'random' else as_often_wrong(other, own)
    first, second = median_minutes(own, 0.0), median_minutes(other, sure)
    paper = 0.0 if peer == 'random' else RULES[peer].decided
    by_paper = '' if peer == 'random' else (
        f' from {sure:.1f} on; from {paper:.1f} on, as published, '
        f'{median_minutes(other, paper):.2f} min and {wrongs(other, paper)} wrong')
    return Figure(
        ISSUE, f'median minutes over those of {peer}', first / second, '1', f'≤ {target:.2g}',
        f'{first:.2f} and {second:.2f} min; of {len(both)} worlds {wrongs(own, 0.0)} and '
        f'{wrongs(other, sure)} wrong{by_paper}', first / second <= target)


def wrongs(runs: Sequence[Run], sure: float) -> int:
    """How many say something first, from so `sure` on, that was not hidden."""
    return sum(bool(r.taken(sure)[1] - set(r.hidden)) for r in runs)


def as_often_wrong(runs: Sequence[Run], own: Sequence[Run]) -> float:
    """From how sure on `runs` are wrong no more often than our `own`: the least that does."""
    most = wrongs(own, 0.0)
    steps = sorted({0.0, *(odds for r in runs for *_, odds in r.course if odds > 0)})
    return next((sure for sure in steps if wrongs(runs, sure) <= most), math.inf)


def median_minutes(runs: Sequence[Run], sure: float) -> float:
    """Until the first word, from so `sure` on, where it is right; else as long as it may take.

    Of the worlds in which one effect of the library is hidden.
    """
    first = [(r.taken(sure), set(r.hidden)) for r in runs if r.hidden and r.hidden[0] in LISTED]
    return median(minutes if names == hidden else MINUTES
                  for (minutes, names), hidden in first) if first else math.nan


def told_unlisted(one: Run) -> bool:
    """Whether what is in no list is told as such, against what it depends on."""
    words = COVARIATES[one.hidden[0]].split()
    return bool(one.left) and any(word in left for left in one.left[:3] for word in words)


def _share(name: str, runs: Sequence[Run], true: Callable[[Run], bool], target: float,
           most: bool = False) -> Figure:
    count = sum(map(true, runs))
    low, high = wilson(count, len(runs))
    value = count / len(runs) if runs else math.nan
    return Figure(ISSUE, name, value, '1', f'{"≤" if most else "≥"} {target}',
                  f'{count} of {len(runs)}, 95 %: {low:.2f} to {high:.2f}',
                  value <= target if most else value >= target)


def wilson(count: int, total: int) -> tuple[float, float]:
    """The 95 % interval of a share `count` of `total` (Wilson 1927); 0 to 1 of none."""
    if not total:
        return 0.0, 1.0
    z, p = 1.96, count / total
    middle = (p + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * math.sqrt(p * (1 - p) / total + z**2 / (4 * total**2))
    return middle - half, middle + half


# What is run ------------------------------------------------------------------------------------

def _effects(asked: str) -> list[Case]:
    return [(asked, (effect,), seed) for seed in range(SEEDS) for effect in LISTED]


def _nulls() -> list[Case]:
    return [('nothing', (), 1000 + seed) for seed in range(NULLS)]


def _twins() -> list[Case]:
    return [('twins', (effect,), 2000) for effect in LISTED]


def _pairs() -> list[Case]:
    return [('pairs', pair, 3000 + seed) for seed in range(SEEDS) for pair in PAIRS]


def _unlisted() -> list[Case]:
    return [('unlisted', (effect,), 5000 + seed) for seed in range(SEEDS) for effect in UNLISTED]


def _rival(rule: str) -> list[Case]:
    others = _nulls()[:RIVAL_NULLS], _unlisted()[:RIVAL_UNLISTED * len(UNLISTED)]
    return in_turns([_effects(rule), *(
        [(rule, hidden, seed) for _, hidden, seed in kind] for kind in others)])


def run(case: Case) -> Run:
    """One world, asked in one way."""
    asked, hidden, seed = case
    rig, _ = hidden_world(seed, hidden)
    if asked in RULES:
        return _ruled(asked, RULES[asked], hidden, seed, rig)
    minutes = PAIR_MINUTES if asked == 'pairs' else MINUTES
    with _twin(hidden[0]) if asked == 'twins' else _alone():
        designer = _at_random if asked == 'random' else None
        driven = drive(rig, minutes, seed=seed, **({'designer': designer} if designer else {}))
        return _told(asked, hidden, seed, driven)


def _ruled(asked: str, rule: Rule, hidden: tuple[str, ...], seed: int, rig: SimulatedRig) -> Run:
    said = by_rule(rule, rig, MINUTES, seed)
    taken = next((one for one in said if one.sure > rule.decided), None)
    return Run(asked, hidden, seed, 'settled' if taken else 'out_of_time',
               (taken or said[-1]).seconds / 60, (taken.name,) if taken and taken.name else (),
               (), (), (), tuple((one.seconds / 60, one.name, one.sure) for one in said))


def _told(asked: str, hidden: tuple[str, ...], seed: int, driven: Driven) -> Run:
    insight = driven.insight
    if insight is None:
        return Run(asked, hidden, seed, driven.decided, driven.seconds / 60, (), (), (), ())
    judgement = insight.judgement
    ever = {name for look in driven.looks if look.judgement
            for name in look.judgement.named} if asked == 'nothing' else set()
    after = driven.named_after
    minutes = (driven.seconds if after is None else after) / 60
    return Run(asked, hidden, seed, driven.decided, minutes,
               tuple(ever) or judgement.named,
               tuple(itertools.chain.from_iterable(judgement.open.values())),
               tuple(m.against for m in judgement.left), driven.twins, tuple(
                   (look.seconds / 60, '+'.join(look.judgement.named), SETTLED)
                   for look in driven.looks if look.judgement and look.judgement.settled))


def _at_random(fit: ModelFit, questions: Sequence[Question],  # noqa: ARG001
               search: Search | None, begin: float, duration: float,  # noqa: ARG001
               limits: Range, rng: np.random.Generator) -> Design:
    return Design(random_steps(rng, duration, limits), np.full(len(questions), np.inf))


@contextmanager
def _alone() -> Iterator[None]:
    yield


@contextmanager
def _twin(name: str) -> Iterator[None]:
    """The library with a second effect that does the same as `name`, under another name.

    As a creeping stage and a flowing liquid would, or a fuel that runs out and a lamp that fades.
    """
    other = f'{name}_twin'
    kind = dataclasses.dataclass(frozen=True)(type(other, (EFFECTS[name],), {'id': other}))
    effects: dict[str, Any] = vars(EFFECTS).setdefault('_effects', dict(EFFECTS))
    effects[other] = kind
    try:
        yield
    finally:
        del effects[other]


def _design_seconds() -> Figure:
    """Of processor time that a plan takes, as part of a drive."""
    spent: list[float] = []

    def timed(*args: Any) -> Design:
        from microbot_ros.discovery.driven.design import choose_plan

        start = time.process_time()
        design = choose_plan(*args)
        spent.append(time.process_time() - start)
        return design

    rig, _ = hidden_world(0, ('amplifier_deadband',))
    drive(rig, MINUTES, seed=0, designer=timed)
    slowest = max(spent)
    return Figure(ISSUE, 'design of one plan, slowest', slowest, 's', '≤ 5', '', slowest <= 5)
