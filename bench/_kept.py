"""Outcomes kept as they come: a bench of hours that is stopped goes on where it was.

A line of JSON for every case, under the code that judged it: what other code said is run again.
Where all groups share an hour each begins its cases in order until its time is over, and a figure
is of those that are there.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import itertools
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any, TypeVar

from bench.figure import SHARE_S

Given, Judged = TypeVar('Given'), TypeVar('Judged')


def run_kept(path: Path, cases: Iterable[Given], judge: Callable[[Given], Judged],
             again: Callable[[dict[str, Any]], Judged], jobs: int = 2) -> list[Judged]:
    """What `judge` says of the `cases`, `jobs` at a time on one core each.

    Each outcome, a dataclass, is a line in `path` as soon as it is there, and `again` makes it
    from its fields; cases found there under the same code are not run. Tells on stderr how far
    it is. Cases that `SHARE_S` left no time for are left out.
    """
    from rich.console import Console
    from rich.progress import Progress

    wanted, code = list(cases), code_version()
    known = dict(_read(path, code))
    path.parent.mkdir(parents=True, exist_ok=True)
    missing = [case for case in wanted if _key(case) not in known]
    begun, pending = time.monotonic(), dict[Future[Judged], Given]()
    with (ProcessPoolExecutor(jobs, initializer=one_core) as pool, path.open('a') as kept,
          Progress(console=Console(stderr=True)) as shown):
        bar = shown.add_task(path.stem, total=len(missing))
        while missing or pending:
            while missing and len(pending) < jobs:
                case = missing.pop(0)
                pending[pool.submit(judge, case)] = case
            for done in wait(pending, return_when=FIRST_COMPLETED).done:
                key, told = _key(pending.pop(done)), dataclasses.asdict(done.result())  # type: ignore[call-overload]
                kept.write(json.dumps({'code': code, 'case': key, 'outcome': told},
                                      ensure_ascii=False) + '\n')
                kept.flush()
                known[key] = json.loads(json.dumps(told))
                shown.advance(bar)
            if time.monotonic() - begun > SHARE_S:
                missing.clear()
    return [again(known[key]) for case in wanted if (key := _key(case)) in known]


def in_turns(kinds: Iterable[Sequence[Given]]) -> list[Given]:
    """Cases of several `kinds`, one of each in turn, so that any part of them has all kinds."""
    return [case for turn in itertools.zip_longest(*kinds) for case in turn if case is not None]


def code_version() -> str:
    """A hash of the sources loaded of the package and the bench, but for comments and layout."""
    digest = hashlib.sha256()
    for name in sorted(sys.modules):
        source = getattr(sys.modules[name], '__file__', None)
        if name.split('.')[0] in ('microbot_ros', 'bench') and source and source.endswith('.py'):
            digest.update(ast.dump(ast.parse(Path(source).read_text(encoding='utf-8'))).encode())
    return digest.hexdigest()[:12]


def one_core() -> None:
    """Keep this process to one core."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


def _key(case: object) -> str:
    return json.dumps(case, ensure_ascii=False)


def _read(path: Path, code: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """(case, outcome) of every whole line of `path` that this `code` wrote."""
    if not path.exists():
        return
    for line in path.read_text(encoding='utf-8').splitlines():
        try:
            entry = json.loads(line)
        except ValueError:  # it was stopped in the middle of a line
            continue
        if entry['code'] == code:
            yield entry['case'], entry['outcome']
