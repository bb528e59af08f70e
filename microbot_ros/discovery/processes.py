"""The parts of a search in several processes, which inherit what they work on.

Workers are forked when there is work and end with it: what it is about, a session of many
megabytes, is theirs without being sent. Only what they find is.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, Protocol, TypeVar

Given = TypeVar('Given')
Found = TypeVar('Found')

_work: tuple[Callable[[Any], Any], Sequence[Any]] | None = None
"""What workers are forked with: a function, and what it is to be called with."""


class Run(Protocol):
    """Calls a function with each of some items; what it returns, in their order."""

    def __call__(self, call: Callable[[Given], Found], items: Sequence[Given]) -> Iterable[Found]:
        """What `call` returns for each of `items`."""


def serially(call: Callable[[Given], Found], items: Sequence[Given]) -> Iterable[Found]:
    """What `call` returns for each of `items`, one after the other."""
    return [call(item) for item in items]


def in_processes(call: Callable[[Given], Found], items: Sequence[Given],
                 jobs: int) -> Iterable[Found]:
    """What `call` returns for each of `items`, from that many `jobs` forked for it.

    Neither `call` nor the items need be sent; what is found is pickled.
    """
    global _work
    if len(items) < 2:
        return serially(call, items)
    _work = call, items
    try:
        context = multiprocessing.get_context('fork')
        with ProcessPoolExecutor(min(jobs, len(items)), context) as pool:
            return list(pool.map(_one, range(len(items))))
    finally:
        _work = None


def _one(index: int) -> Any:
    assert _work is not None
    call, items = _work
    return call(items[index])
