"""The score card of discovery on blind sessions, with its rivals on the same ones beside it.

Counts come with their exact 95 % binomial intervals, since the number of sets is what the time
allows; `out/discovery_suite.json` has every set with its seed. About 18 minutes on two cores.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from bench import _coverage
from bench._hidden_suite import blind
from bench._score_card import (
    PYSINDY,
    SFI,
    Outcome,
    judge,
    null_cases,
    one_each,
    power_cases,
    run,
    two_at_once,
    under_narrow_commands,
    unlisted_cases,
)
from bench.figure import Figure, sized
from microbot_ros.common.files import write_text


def figures() -> list[Figure]:
    """All cards."""
    outcomes = run([
        *null_cases(sized(240, 24)), *one_each('plain', 40.0, sized(4, 1), 10_000),
        *one_each('strong', 100.0, sized(4, 1), 20_000), *under_narrow_commands(1, 100.0),
        *two_at_once(sized(24, 6), 100.0), *unlisted_cases(sized(3, 1), 100.0),
        *power_cases(sized(10, 3)),
    ], judge)
    entries = [dataclasses.asdict(outcome) for outcome in outcomes]
    write_text(Path('out/discovery_suite.json'), json.dumps(entries, indent=1) + '\n')
    covered = run(_coverage.cases(sized(6, 1)), _coverage.judge)
    return [*score(outcomes), *_covered([c for found in covered for c in found]),
            _time()]


def score(outcomes: Iterable[Outcome]) -> list[Figure]:
    """The figures of outcomes from all cards."""
    card: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        card.setdefault(outcome.case.card, []).append(outcome)
    named = [o for key in ('plain', 'strong', 'narrow') for o in card[key]]
    return [
        *_nothing_missing(card['null']),
        _share('first name right at λ = 40', [o.first for o in card['plain']], 0.97,
               peer=f'theory: {_allowed(card["plain"]):.1f}'),
        _share('exact set right at λ = 100, not near the floor of the instrument',
               [o.exact for o in card['strong'] if not o.near_floor], 0.95,
               peer=_rivals(card['strong'], lambda said, o: said == o.case.effects)),
        _share('truth named or in the ambiguity set', [o.suspected for o in named], 0.99),
        _share('two at once, exact set right',
               [o.exact for o in card['two'] if not o.near_floor], 0.90),
        _share('in no list: told', [o.told for o in card['unlisted']], 0.95),
        _share('in no list: wrong established name',
               [bool(o.established) for o in card['unlisted']], 0.02, at_most=True),
        _coverage_of_named(named),
        *_gap([o for key in ('plain', 'strong') for o in card[key]]),
        _power(card['power']),
        *_seconds([o.seconds for known in card.values() for o in known]),
    ]


def _nothing_missing(outcomes: list[Outcome]) -> list[Figure]:
    return [
        _share('nothing missing: established names',
               [bool(o.established) for o in outcomes], 0.01, at_most=True,
               peer=_rivals(outcomes, lambda said, _: bool(said))),
        _share('nothing missing: called consistent',
               [o.verdict == 'consistent' for o in outcomes], 0.98),
    ]


def _allowed(outcomes: list[Outcome]) -> float:
    """How many effects theory can name: the log evidence (λ − k ln n)/2 is above zero.

    By chance λ is distributed as a noncentral χ² of k degrees of freedom.
    """
    from scipy.stats import ncx2

    return sum(float(ncx2.sf(o.unknowns * math.log(o.rows), o.unknowns, o.case.evidence))
               for o in outcomes)


def _rivals(outcomes: list[Outcome], hit: Callable[[tuple[str, ...], Outcome], bool]) -> str:
    """Of how many sessions that a rival has seen what it said is a `hit`, in words."""
    judged = {name: [hit(o.rivals_said[name], o) for o in outcomes if name in o.rivals_said]
              for name in (PYSINDY, SFI)}
    return ', '.join(f'{name}: {sum(hits)} of {len(hits)}' for name, hits in judged.items())


def interval(hits: int, count: int) -> tuple[float, float]:
    """The exact 95 % interval of a probability (Clopper and Pearson 1934)."""
    from scipy.stats import binomtest

    low, high = binomtest(hits, count).proportion_ci(0.95)
    return float(low), float(high)


def _share(name: str, right: list[bool], target: float, *, at_most: bool = False,
           peer: str = '–') -> Figure:
    hits, count = sum(right), len(right)
    low, high = interval(hits, count)
    value = hits / count
    ok = value <= target if at_most else value >= target
    return Figure(
        5, f'{name} ({hits} of {count}; 95 %: {low:.1%}–{high:.1%})', 100 * value, '%',
        f'{"≤" if at_most else "≥"} {100 * target:g}', peer, ok)


def _coverage_of_named(outcomes: list[Outcome]) -> Figure:
    held = [c for o in outcomes for c in o.covered]
    low, high = interval(sum(held), len(held))
    value = 100 * float(np.mean(held))
    return Figure(
        5, f'named effects: 95 % intervals hold the truth ({sum(held)} of {len(held)}; '
        f'95 %: {low:.1%}–{high:.1%})', value, '%', '92–98', 'PySINDy: has none',
        92 <= value <= 98)


def _covered(found: list[_coverage.Covered]) -> list[Figure]:
    """Each kind of quantity, over all effects, and the effect under which it does worst."""
    figures = []
    for kind in dict.fromkeys(one.kind for one in found):
        held: dict[str, list[bool]] = {}
        for one in found:
            if one.kind == kind:
                held.setdefault(one.effect or 'nothing', []).append(one.held)
        every = [h for known in held.values() for h in known]
        low, high = interval(sum(every), len(every))
        worst = min(held, key=lambda name: sum(held[name]) / len(held[name]))
        least = interval(sum(held[worst]), len(held[worst]))
        value = 100 * float(np.mean(every))
        figures.append(Figure(
            16, f'95 % intervals of {kind} ({sum(every)} of {len(every)}; 95 %: {low:.1%}–'
            f'{high:.1%}; least under {worst}, {sum(held[worst])} of {len(held[worst])}: '
            f'{least[0]:.0%}–{least[1]:.0%})', value, '%', '92–98', 'PySINDy: has none',
            92 <= value <= 98))
    return figures


def _seconds(spent: list[float]) -> list[Figure]:
    middle, most = float(np.median(spent)), max(spent)
    return [Figure(16, f'seconds of a search, median of {len(spent)} on one core', middle, 's',
                   '≤ 10', '–', middle <= 10),
            Figure(16, 'seconds of a search, worst', most, 's', '≤ 20', '–', most <= 20)]


def _gap(outcomes: list[Outcome]) -> list[Figure]:
    """Held out, over sets in which something can be seen to be missing."""
    known = np.array([o.excess for o in outcomes])
    known = known[np.isfinite(known).all(axis=1)]
    before, after, truth, floor = (known**2).sum(axis=0)
    ratio = math.sqrt((after + floor) / (truth + floor))
    excess = math.sqrt(after / truth)
    name = f'over {len(known)} sets; before {math.sqrt(before / truth):.2f}×'
    return [
        Figure(5, f'held-out excess after, against the true model’s ({name})', excess, '×',
               '≤ 1.1', 'true model', excess <= 1.1),
        Figure(5, 'held-out RMS after, against the true model’s', ratio, '×', '≤ 1.1',
               'true model', ratio <= 1.1),
    ]


def _power(outcomes: list[Outcome]) -> Figure:
    """Where a logistic curve through found and not found passes one half, over k ln n."""
    from scipy.optimize import minimize

    part = np.array([o.case.evidence / (o.unknowns * math.log(o.rows)) for o in outcomes])
    found = np.array([o.first for o in outcomes])

    def cost(shape: np.ndarray) -> float:
        odds = np.exp(shape[1]) * (np.log(part) - shape[0])
        return float(np.logaddexp(0, np.where(found, -odds, odds)).sum() + 0.01 * shape[1] ** 2)

    half = float(np.exp(minimize(cost, np.array([0.0, 1.0]), method='Nelder-Mead').x[0]))
    return Figure(5, f'λ found half the time, over k ln n ({len(part)} sets)', half, '×',
                  '≤ 1.25', 'theory', half <= 1.25)


def _time() -> Figure:
    """Four particles, 60 s at 30 Hz, with the report, on one core."""
    import tempfile

    from threadpoolctl import threadpool_limits

    from microbot_ros.discovery.discover import discover
    from microbot_ros.discovery.report.page import write_report

    session = next(
        b.session for seed in range(100)
        if (b := blind(seed, 'paper', ('uniform_drift',), 60.0, count=4))
        .session.conditions.frame_rate == 30)
    with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        write_report(Path(folder), discover([session]), [session], [])
        spent = time.perf_counter() - began
    return Figure(5, 'time, 4 particles, 60 s, 30 Hz, one core, with report', spent, 's', '≤ 10',
                  '–', spent <= 10)
