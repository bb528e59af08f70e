"""The rig asks its own questions: minutes until what is hidden has its name, and wrong names.

Worlds of the fine physics, a camera, a view with edges; the loop without a graph. Every effect is
hidden so that a minute of random steps would hold λ = 10 of evidence. The rivals are random steps
judged by the same rules, and the rules of the literature. The worlds are drawn by seed, and what
came of each is in `out/asks.jsonl`: of every kind of run as many as of any other at any time.
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

from bench._asks_rivals import RULES, by_rule
from bench._asks_worlds import hidden_world
from bench._hidden_effects import LISTED, UNLISTED
from bench._kept import run_kept
from bench.figure import Figure
from microbot_ros.discovery.driven.design import Design, Question, Range, Search, random_steps
from microbot_ros.discovery.driven.drive import Driven, drive
from microbot_ros.estimation.model_fit import ModelFit
from microbot_ros.model.effects import EFFECTS

ISSUE = 18
MINUTES, PAIR_MINUTES, OTHER_MINUTES = 6.0, 10.0, 6.0
SEEDS, NULLS = 4, 200

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


Case = tuple[str, tuple[str, ...], int]
"""How it is asked, what is hidden, and the seed."""


@dataclasses.dataclass(frozen=True)
class Run:
    """What came of one world: who `asked`, what was `hidden`, what was `named`.

    `minutes` until the names were there, for good and alone; until the end where they never were.
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

    @property
    def right(self) -> bool:
        """Whether exactly what was hidden is named, and nothing else can be it."""
        return (self.decided == 'settled' and set(self.named) == set(self.hidden)
                and not self.open and not self.left)

    @property
    def wrong(self) -> bool:
        """Whether something is established that was not hidden."""
        return bool(set(self.named) - set(self.hidden)) and not self.left and not self.open


def figures() -> list[Figure]:
    """Every figure of the issue."""
    runs = run_kept(Path('out/asks.jsonl'), every_case(), run, _again)
    return [*score(runs), _design_seconds()]


def every_case() -> list[Case]:
    """All that is run, kind by kind in turns."""
    kinds = [_effects('asks'), _nulls(), _unlisted(), _pairs(), _twins(),
             *(_effects(asked) for asked in ('random', *RULES))]
    return [case for turn in itertools.zip_longest(*kinds) for case in turn if case]


def _again(told: dict[str, Any]) -> Run:
    """A run from its fields as JSON has them."""
    pairs = tuple((one, other) for one, other in told.pop('twins'))
    return Run(**{key: tuple(value) if isinstance(value, list) else value
                  for key, value in told.items()}, twins=pairs)


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
    own = _median_minutes(of['asks'])
    for peer, target in (('random', 0.5), *((rule, 1 / 1.5) for rule in RULES)):
        other = _median_minutes(of[peer])
        wrong = sum(r.wrong for r in of[peer])
        result.append(Figure(
            ISSUE, f'median minutes over those of {peer}', own / other, '1', f'≤ {target:.2g}',
            f'{own:.2f} and {other:.2f} min; {wrong} of {len(of[peer])} wrong by {peer}',
            own / other <= target))
    return [figure for figure in result if math.isfinite(figure.value)]


def told_unlisted(one: Run) -> bool:
    """Whether what is in no list is told as such, against what it depends on."""
    words = COVARIATES[one.hidden[0]].split()
    return bool(one.left) and any(word in left for left in one.left[:3] for word in words)


def _median_minutes(runs: Sequence[Run]) -> float:
    """Until it was right; as long as it may take where it was not."""
    return median(r.minutes if r.right else MINUTES for r in runs) if runs else math.nan


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
    return [('unlisted', (effect,), 4000 + seed) for seed in range(SEEDS) for effect in UNLISTED]


def run(case: Case) -> Run:
    """One world, asked in one way."""
    asked, hidden, seed = case
    rig, _ = hidden_world(seed, hidden)
    if asked in RULES:
        taken = by_rule(RULES[asked], rig, MINUTES, seed)
        names = (taken.name,) if taken.name else ()
        return Run(asked, hidden, seed, 'out_of_time' if taken.name is None else 'settled',
                   taken.seconds / 60, names, (), (), ())
    minutes = PAIR_MINUTES if asked == 'pairs' else MINUTES
    with _twin(hidden[0]) if asked == 'twins' else _alone():
        designer = _at_random if asked == 'random' else None
        driven = drive(rig, minutes, seed=seed, **({'designer': designer} if designer else {}))
        return _told(asked, hidden, seed, driven)


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
               tuple(m.against for m in judgement.left), driven.twins)


def _at_random(fit: ModelFit, questions: Sequence[Question], search: Search, begin: float,  # noqa: ARG001
               duration: float, limits: Range, rng: np.random.Generator) -> Design:
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
