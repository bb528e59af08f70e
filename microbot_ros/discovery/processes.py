"""The parts of a search in several processes, which inherit what they work on.

Workers are forked when there is work and end with it: what it is about, sessions of many
megabytes, is theirs without being sent. Only what they find is, and of that neither what the
caller has himself nor what follows from the rest.
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

Given = TypeVar('Given')
Found = TypeVar('Found')


class Run(Protocol):
    """Calls a function with each of some items; what it returns, in their order."""

    def __call__(self, call: Callable[[Given], Found], items: Sequence[Given],
                 kept: Sequence[object] = ()) -> Iterable[Found]:
        """What `call` returns for each of `items`; in it those `kept` are those of the caller."""


def serially(call: Callable[[Given], Found], items: Sequence[Given],
             kept: Sequence[object] = ()) -> Iterable[Found]:  # noqa: ARG001
    """What `call` returns for each of `items`, one after the other; all are `kept` anyhow."""
    return [call(item) for item in items]


@dataclass(frozen=True)
class _Work:
    """What workers are forked with."""

    call: Callable[[Any], Any]
    items: Sequence[Any]
    kept: Sequence[object]


_work: _Work | None = None


def in_processes(call: Callable[[Given], Found], items: Sequence[Given],
                 kept: Sequence[object] = (), *, jobs: int) -> Iterable[Found]:
    """What `call` returns for each of `items`, from as many `jobs` that are forked for it.

    Neither `call` nor the items are sent. What is found is pickled, but for objects `kept` of the
    caller's in it, for which the caller's own stand in what is returned.
    """
    global _work
    if len(items) < 2:
        return serially(call, items)
    _work = _Work(call, items, kept)
    try:
        context = multiprocessing.get_context('fork')
        # Frozen, what is inherited is not copied because garbage is looked for in it.
        with ProcessPoolExecutor(min(jobs, len(items)), context, gc.freeze) as pool:
            return [_Reader(io.BytesIO(found), kept).load()
                    for found in pool.map(_found, range(len(items)))]
    finally:
        _work = None


def _found(index: int) -> bytes:
    """What is found for one of the items, as bytes."""
    assert _work is not None
    file = io.BytesIO()
    _Writer(file, _work.kept).dump(_work.call(_work.items[index]))
    return file.getvalue()


class _Writer(pickle.Pickler):
    """Writes the fields of dataclasses, not what was worked out from them, and no object kept."""

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
    """Reads it, with the objects kept in their places."""

    def __init__(self, file: io.BytesIO, kept: Sequence[object]) -> None:
        super().__init__(file)
        self._kept = kept

    def persistent_load(self, pid: int) -> object:
        return self._kept[pid]
