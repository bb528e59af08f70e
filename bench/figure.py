"""One measured figure, and the clock that measures ratios fairly."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Figure:
    """A number, what it had to reach and against whom: one entry of `out/bench.json`."""

    issue: int
    name: str
    value: float
    unit: str
    target: str
    peer: str
    ok: bool


def seconds(*calls: Callable[[], object], rounds: int = 7) -> list[float]:
    """Median seconds of each call, the calls interleaved so that noise hits all alike."""
    for call in calls:
        call()
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(rounds):
        for call, spent in zip(calls, times, strict=True):
            start = time.perf_counter()
            call()
            spent.append(time.perf_counter() - start)
    return [median(spent) for spent in times]
