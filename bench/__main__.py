"""`make bench`: run every group, print a table, write `out/bench.json`.

Each group runs in a process of its own and tells each figure as it comes, so that one that fails
loses only what it has not measured. All together end within an hour, most of them with fewer runs
than behind a published figure; `--full` gives every group all its runs and as long as it needs.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib
import json
import math
import os
import pkgutil
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import bench
from bench.figure import Figure, Timing
from microbot_ros.common.files import write_text

_LAST = ['drive', 'judge', 'discovery', 'films', 'learned', 'asks']
"""Groups of more than four minutes each come last, so that no others are left without time."""
GROUPS = sorted(
    (module.name for module in pkgutil.iter_modules(bench.__path__)
     if module.name not in ('figure', '__main__') and not module.name.startswith('_')),
    key=lambda name: (_LAST.index(name) + 1 if name in _LAST else 0, name))
"""In the order in which they run."""
TOTAL_S = 58 * 60
"""Time of all groups together, unless they run in full: an hour with what starts and ends."""
GROUP_S, PARTS = 10 * 60, 4
"""Most time of one group, unless it runs in full or alone: in all, and as so many times its part
of what is left to it and those after it, so that the last have time as well."""
SHARE_S = 90
"""Time in which such a group begins cases that it keeps: the next run goes on with others."""
_GRACE_S = 10.0
"""Between the request to end and the kill: children of a group need a moment to zero coils."""


def main() -> int:
    """Run the chosen groups; exit 1 if any figure missed its target."""
    parser = argparse.ArgumentParser(prog='make bench', description=__doc__)
    parser.add_argument('--only', choices=GROUPS, help='run one group, as long as it takes')
    parser.add_argument('--full', action='store_true', help='all runs of every group: many hours')
    parser.add_argument('--cases', type=int, help='sessions of each kind that `judge` takes')
    parser.add_argument('--into', type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.cases is not None and (chosen.only != 'judge' or chosen.cases < 1):
        parser.error('--cases takes a number of sessions from 1 on, and needs --only judge')
    if chosen.into:
        _measure(importlib.import_module(f'bench.{chosen.only}').figures(), chosen.into)
        return 0
    if chosen.full:
        os.environ['MICROBOT_BENCH_FULL'] = '1'
    if chosen.cases is not None:
        os.environ['MICROBOT_BENCH_CASES'] = str(chosen.cases)
    if not (chosen.full or chosen.only):
        os.environ['MICROBOT_BENCH_SHARE_S'] = str(SHARE_S)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no group outlives it
    entries: list[dict[str, Any]] = []
    deadline = time.monotonic() + (math.inf if chosen.full or chosen.only else TOTAL_S)
    groups = [chosen.only] if chosen.only else GROUPS
    for before, group in enumerate(groups):
        limit = deadline - time.monotonic()
        if math.isfinite(limit):
            limit = min(GROUP_S, PARTS * limit / (len(groups) - before), limit)
        entries += run(group, limit)
        write_text(Path('out/bench.json'), _as_json(entries))
    _show(entries)
    return 0 if all(entry['ok'] for entry in entries) else 1


def run(group: str, limit_s: float) -> list[dict[str, Any]]:
    """Run a `group` for at most `limit_s` [s] in a process of its own and return its entries.

    What ends it before it has all its figures is an entry that missed its target.
    """
    begun, began = about(), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        into = Path(folder) / 'figures.json'
        problem = 'no time was left; try --full' if limit_s <= 0 else _run(group, into, limit_s)
        figures = json.loads(into.read_text('utf-8')) if into.exists() else []
    if problem:
        figures.append(_entry(Figure(
            0, f'{group}: {problem}', math.nan, '', 'measured', '', False)))
    load = [begun['load'], about()['load']]
    spent_s = time.monotonic() - began
    print(f'bench: {group}: {spent_s / 60:.1f} min', file=sys.stderr, flush=True)
    return [{**figure, 'group': group, **begun, 'load': load} for figure in figures]


def _run(group: str, into: Path, limit_s: float) -> str:
    """Run a group; why it ended before it had all its figures."""
    print(f'bench: {group} …', file=sys.stderr, flush=True)
    with subprocess.Popen([sys.executable, '-m', 'bench', '--only', group, '--into', into],
                          start_new_session=True) as process:
        try:
            status = process.wait(None if math.isinf(limit_s) else limit_s)
        except subprocess.TimeoutExpired:
            return f'had not ended after {limit_s / 60:.0f} min; try --full'
        finally:
            _end(process)
    return f'ended with status {status}, see above' if status else ''


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a group and all that it started."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_GRACE_S)


def about() -> dict[str, Any]:
    """Return what a figure depends on beside the code's own work: commit, machine, load."""
    def told(*words: str) -> str:
        return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()

    changed = '+' if told('git', 'status', '--porcelain', '--untracked-files=no') else ''
    models = [line.partition(':')[2].strip() for line in Path('/proc/cpuinfo').read_text()
              .splitlines() if line.startswith('model name')]
    return {'commit': told('git', 'rev-parse', '--short', 'HEAD') + changed,
            'machine': f'{os.cpu_count()} × {models[0] if models else platform.machine()}',
            'load': round(os.getloadavg()[0], 2)}


def _entry(figure: Figure) -> dict[str, Any]:
    spread = figure.value.spread if isinstance(figure.value, Timing) else figure.spread
    return {**dataclasses.asdict(figure), 'spread': spread,
            'value': figure.value if math.isfinite(figure.value) else None}


def _measure(figures: Iterable[Figure], into: Path) -> None:
    """Write each of the figures as it comes: what is measured stays if the rest takes too long."""
    done = []
    for figure in figures:
        done.append(_entry(figure))
        write_text(into, _as_json(done))


def _as_json(entries: list[dict[str, Any]]) -> str:
    # Figures may hold NumPy's own numbers and truth values.
    return json.dumps(
        entries, indent=1, ensure_ascii=False, default=lambda value: value.item()) + '\n'


def _show(entries: list[dict[str, Any]]) -> None:
    table = Table('issue', 'figure', 'value', '±', 'unit', 'target', 'peer', '')
    for entry in entries:
        value, spread = ('' if entry[name] is None else f'{entry[name]:.{digits}g}'
                         for name, digits in (('value', 4), ('spread', 2)))
        table.add_row(
            str(entry['issue']), entry['name'], value, spread, entry['unit'], entry['target'],
            entry['peer'], '[green]ok[/]' if entry['ok'] else '[red]MISSED[/]')
    Console(width=160 if not sys.stdout.isatty() else None).print(table)


if __name__ == '__main__':
    sys.exit(main())
