"""Parallel map over forked processes that inherit their data.

Workers are forked when there is work and end with it: they inherit sessions of many megabytes
without any transfer. Only results are sent back, without objects that the caller already has and
without cached values.
"""

from __future__ import annotations

import copyreg
import gc
import io
import multiprocessing
import pickle
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Protocol, TypeVar

from microbot_ros.common.compiled import load

Given = TypeVar('Given')
Found = TypeVar('Found')


class Run(Protocol):
    """Protocol of a map: calls a function with each item and returns the results in order."""

    def __call__(self, call: Callable[[Given], Found], items: Sequence[Given],
                 kept: Sequence[object] = ()) -> Iterable[Found]:
        """Return the results of `call` for `items`, with the caller's own `kept` objects."""


def serially(call: Callable[[Given], Found], items: Sequence[Given],
             kept: Sequence[object] = ()) -> Iterable[Found]:  # noqa: ARG001
    """Call a function with each item, one after the other.

    Parameters
    ----------
    call : callable
        Function of one item.
    items : sequence
        Its arguments.
    kept : sequence of object, optional
        Not used: all objects are the caller's own.

    Returns
    -------
    iterable
        Results in the order of the items.
    """
    return [call(item) for item in items]


@dataclass(frozen=True)
class _Work:
    """What workers inherit: the function, its arguments and the objects that are not sent back."""

    call: Callable[[Any], Any]
    items: Sequence[Any]
    kept: Sequence[object]


_work: _Work | None = None


def in_processes(call: Callable[[Given], Found], items: Sequence[Given],
                 kept: Sequence[object] = (), *, jobs: int) -> Iterable[Found]:
    """Call a function with each item in forked processes.

    Neither the function nor the items are sent; results are pickled.

    Parameters
    ----------
    call : callable
        Function of one item.
    items : sequence
        Its arguments; fewer than two are handled in this process.
    kept : sequence of object, optional
        Objects that results may contain and that are not sent back: the caller's own replace them.
    jobs : int
        Maximum number of processes.

    Returns
    -------
    iterable
        Results in the order of the items.
    """
    global _work
    if len(items) < 2:
        return serially(call, items)
    _work = _Work(call, items, kept)
    try:
        load()  # once, not in each process
        context = multiprocessing.get_context('fork')
        # Without a freeze, garbage collection would write to inherited pages, which copies them.
        with ProcessPoolExecutor(min(jobs, len(items)), context, gc.freeze) as pool:
            return [_Reader(io.BytesIO(found), kept).load()
                    for found in pool.map(_found, range(len(items)))]
    finally:
        _work = None


def _found(index: int) -> bytes:
    """Return the pickled result for one item."""
    assert _work is not None
    file = io.BytesIO()
    _Writer(file, _work.kept).dump(_work.call(_work.items[index]))
    return file.getvalue()


class _Writer(pickle.Pickler):
    """Pickler that omits cached values of dataclasses, and objects that are kept."""

    def __init__(self, file: io.BytesIO, kept: Sequence[object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._places = {id(one): k for k, one in enumerate(kept)}

    def persistent_id(self, obj: Any) -> int | None:
        return self._places.get(id(obj))

    def reducer_override(self, obj: Any) -> Any:
        if not is_dataclass(obj) or isinstance(obj, type):
            return NotImplemented
        state = {field.name: getattr(obj, field.name) for field in fields(obj)}
        return copyreg.__newobj__, (type(obj),), state  # type: ignore[attr-defined]


class _Reader(pickle.Unpickler):
    """Unpickler that inserts the kept objects."""

    def __init__(self, file: io.BytesIO, kept: Sequence[object]) -> None:
        super().__init__(file)
        self._kept = kept

    def persistent_load(self, pid: int) -> object:
        return self._kept[pid]
