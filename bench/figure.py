"""One measured figure, and the clock that measures ratios fairly."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median, quantiles

FULL = os.environ.get('MICROBOT_BENCH_FULL') == '1'
"""Whether every group takes the time that it needs, `make bench FULL=1`, or a part of an hour."""


SHARE_S = float(os.environ.get('MICROBOT_BENCH_SHARE_S', 'inf'))
"""Time [s] after which a group begins no further case of those that it keeps."""


def sized(full: int, brief: int) -> int:
    """Return how many runs a figure is of: `full`, or `brief` where the bench has an hour."""
    return full if FULL else brief


@dataclass(frozen=True)
class Figure:
    """A number, what it had to reach and against whom: one entry of `out/bench.json`.

    `spread` is half of the interval that holds the middle half of the values, in `unit`; taken
    from the value where that is a `Timing`, None where it is unknown.
    """

    issue: int
    name: str
    value: float
    unit: str
    target: str
    peer: str
    ok: bool
    spread: float | None = None


class Timing(float):
    """A median [s] or a ratio of two, with its `spread`: half of the interquartile range."""

    spread: float

    def __new__(cls, value: float, spread: float) -> Timing:
        """Make one of a `value` and its `spread`."""
        made = super().__new__(cls, value)
        made.spread = spread
        return made

    def __getnewargs__(self) -> tuple[float, float]:
        return float(self), self.spread

    def __mul__(self, factor: float) -> Timing:
        return Timing(float(self) * factor, self.spread * abs(factor))

    __rmul__ = __mul__

    def __truediv__(self, other: float) -> Timing:
        value = float(self) / float(other)
        parts = (self.spread / float(self), getattr(other, 'spread', 0.0) / float(other))
        return Timing(value, abs(value) * math.hypot(*parts))


def seconds(*calls: Callable[[], object], rounds: int = 7) -> list[Timing]:
    """Median seconds of each call, the calls interleaved so that noise hits all alike."""
    for call in calls:
        call()
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(rounds):
        for call, spent in zip(calls, times, strict=True):
            start = time.perf_counter()
            call()
            spent.append(time.perf_counter() - start)
    quarters = [quantiles(spent, n=4) for spent in times]
    return [Timing(median(spent), (high - low) / 2)
            for spent, (low, _, high) in zip(times, quarters, strict=True)]
