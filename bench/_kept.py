"""Outcomes kept as they come: a bench of hours that is stopped goes on where it was.

A line of JSON for every case, under the code that judged it: what other code said is run again.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

Given, Judged = TypeVar('Given'), TypeVar('Judged')


def run_kept(path: Path, cases: Iterable[Given], judge: Callable[[Given], Judged],
             again: Callable[[dict[str, Any]], Judged], jobs: int = 2) -> list[Judged]:
    """What `judge` says of the `cases`, `jobs` at a time on one core each.

    Each outcome, a dataclass, is a line in `path` as soon as it is there, and `again` makes it
    from its fields; cases found there under the same code are not run. Tells on stderr how far
    it is.
    """
    from rich.console import Console
    from rich.progress import track

    wanted, code = list(cases), code_version()
    known = dict(_read(path, code))
    path.parent.mkdir(parents=True, exist_ok=True)
    missing = [case for case in wanted if _key(case) not in known]
    with ProcessPoolExecutor(jobs, initializer=one_core) as pool, path.open('a') as kept:
        pending = {pool.submit(judge, case): case for case in missing}
        for done in track(as_completed(pending), path.stem, len(pending),
                          console=Console(stderr=True)):
            key, told = _key(pending[done]), dataclasses.asdict(done.result())  # type: ignore[call-overload]
            kept.write(json.dumps({'code': code, 'case': key, 'outcome': told},
                                  ensure_ascii=False) + '\n')
            kept.flush()
            known[key] = json.loads(json.dumps(told))
    return [again(known[_key(case)]) for case in wanted]


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
