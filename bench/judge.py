"""The benchmark by which discovery is judged: known worlds, nuisances and foreign simulators.

Each count has its exact 95 % interval. `out/judge.json` has every session with its seed and its
result. `CASES` is the number of sessions of each kind; with one it takes some 10 minutes on one
core.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from bench._foreign_worlds import judging_cases
from bench._judge_cases import Judged, checking_cases, judge, tuning_cases
from bench._score_card import run
from bench.discovery import interval
from bench.figure import Figure, sized
from microbot_ros.common.files import write_text

ISSUE = 34
CASES = int(os.environ.get('MICROBOT_BENCH_CASES', sized(25, 1)))
"""Sessions of each nuisance and of each foreign world; clean ones eight times as many."""

TABLE = 'out/judge.json'


def figures() -> list[Figure]:
    """Figures of all three families; the table of counts is printed on standard error."""
    missing: list[str] = []
    judged = run([
        *tuning_cases(8 * CASES), *checking_cases(CASES), *judging_cases(CASES, missing)],
        judge, jobs=1)
    write_text(Path(TABLE), json.dumps(
        [as_entry(one) for one in judged], indent=1, ensure_ascii=False) + '\n')
    console = Console(stderr=True, width=None if sys.stderr.isatty() else 150)
    console.print(table(judged))
    for one in judged:
        if not one.right or one.false:
            console.print(describe(one), markup=False)
    for sentence in missing:
        console.print(sentence, markup=False)
    return score(judged)


def as_entry(one: Judged) -> dict[str, object]:
    """What `out/judge.json` has of a session."""
    case = one.case
    return {
        'family': case.family, 'kind': case.kind, 'seed': case.seed, 'commands': case.commands,
        'effects': case.effects, 'verdict': one.verdict, 'established': sorted(one.established),
        'unexplained': one.unexplained, 'right': one.right, 'false': one.false,
        'seconds': round(one.seconds, 2), 'problem': one.problem}


def describe(one: Judged) -> str:
    """One line on a session: how to draw it again, and what discovery made of it."""
    said = ', '.join(sorted(one.established)) or 'no established name'
    rest = one.problem or ', '.join(one.unexplained)
    return f'{one.case}: {one.verdict}; {said}' + (f'; {rest}' if rest else '')


Test = Callable[[Judged], bool]


def crashed(one: Judged) -> bool:
    """Whether a case has no result."""
    return one.verdict in ('crash', 'refused')


COLUMNS: dict[str, tuple[bool, Test]] = {
    'nothing missing: false name': (False, lambda one: one.false),
    'consistent': (False, lambda one: one.right),
    'crash': (False, crashed),
    'one effect: named right': (True, lambda one: one.right),
    'false beside': (True, lambda one: one.false),
    'crash ': (True, crashed),
}
"""Column of the table → whether it is of sessions with an effect, and what it counts."""


def table(judged: Iterable[Judged]) -> Table:
    """Counts with their exact intervals: a row for each kind, and one for each family."""
    judged = list(judged)
    shown = Table('family', 'kind', *COLUMNS, 'median s', 'worst s')
    for family in dict.fromkeys(one.case.family for one in judged):
        own = [one for one in judged if one.case.family == family]
        kinds = list(dict.fromkeys(one.case.kind for one in own))
        for kind in kinds if len(kinds) > 1 else ():
            shown.add_row('', kind, *_row([one for one in own if one.case.kind == kind]))
        shown.add_row(family, 'all', *_row(own), end_section=True)
    return shown


def _row(judged: list[Judged]) -> list[str]:
    cells = []
    for with_effect, test in COLUMNS.values():
        counted = [test(one) for one in judged if bool(one.case.effects) == with_effect]
        cells.append(count(counted) if counted else '–')
    spent = [one.seconds for one in judged]
    return [*cells, f'{np.median(spent):.1f}', f'{max(spent):.1f}']


def count(hits: list[bool]) -> str:
    """'2 of 12 (2–48 %)': a count with its exact 95 % interval."""
    low, high = interval(sum(hits), len(hits))
    return f'{sum(hits)} of {len(hits)} ({100 * low:.0f}–{100 * high:.0f} %)'


def score(judged: Iterable[Judged]) -> list[Figure]:
    """The figures of issue 34."""
    judged = list(judged)

    def of(family: str, with_effect: bool | None = None) -> list[Judged]:
        return [one for one in judged if one.case.family == family
                and with_effect in (None, bool(one.case.effects))]

    null, beside, foreign = of('checking', False), of('checking', True), of('judging')
    spent = [one.seconds for one in judged]
    return [
        *_share('nothing missing, clean: established names', of('tuning', False),
                lambda one: one.false, 0.0, at_most=True),
        *_share('one effect, clean: named right', of('tuning', True), _is_right, 0.95),
        *_share('nothing missing, a nuisance: a false name', null, _is_false, 0.01, at_most=True),
        *_share('nothing missing, a nuisance: consistent', null, _is_right, 0.90),
        *_share('nothing missing, a nuisance: crashes', null, crashed, 0.0, at_most=True),
        *_share('one effect beside a nuisance: named right', beside, _is_right, 0.90),
        *_share('one effect beside a nuisance: something false beside', beside, _is_false, 0.02,
                at_most=True),
        *_share('one effect beside a nuisance: crashes', beside, crashed, 0.0, at_most=True),
        *_share('foreign simulators: wrong names', foreign, _is_false, 0.02, at_most=True),
        *_share('foreign simulators: right or honest', foreign, lambda one: one.honest, 0.90),
        Figure(ISSUE, f'seconds of CPU of a search, median of {len(spent)}',
               float(np.median(spent)), 's', '≤ 2', '–', float(np.median(spent)) <= 2),
        Figure(ISSUE, 'seconds of CPU of a search, worst', max(spent), 's', '≤ 20', '–',
               max(spent) <= 20),
    ]


def _is_right(one: Judged) -> bool:
    return one.right


def _is_false(one: Judged) -> bool:
    return one.false


def _share(name: str, judged: list[Judged], test: Test, target: float, *,
           at_most: bool = False) -> list[Figure]:
    """A share in %, none where there was no case."""
    if not judged:
        return []
    hits = [test(one) for one in judged]
    low, high = interval(sum(hits), len(hits))
    value = sum(hits) / len(hits)
    return [Figure(
        ISSUE, f'{name} ({sum(hits)} of {len(hits)}; 95 %: {low:.1%}–{high:.1%})', 100 * value,
        '%', f'{"≤" if at_most else "≥"} {100 * target:g}', '–',
        value <= target if at_most else value >= target)]
