"""Real-time priority of threads, if the system grants it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SAFETY, LOOP = 10, 5
"""Choice: SCHED_FIFO priorities of what zeroes the coils, and of the rest of the loop."""


def set_realtime_priority(thread: int = 0, priority: int = SAFETY) -> bool:
    """Run a `thread` and those it starts later in real time; return False if not granted.

    0 is the calling thread; a process id is that of its main thread. `priority` is that of
    SCHED_FIFO, 1 to 99.

    Parameters
    ----------
    thread : int
        Thread id; 0 for the calling thread.
    priority : int
        Priority of SCHED_FIFO, 1 to 99.

    Returns
    -------
    bool
        Whether it was granted.
    """
    try:
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError):
        return False
    return True


def set_realtime_priority_of_all(priority: int) -> None:
    """Raise all threads of this process to at least `priority` (SCHED_FIFO).

    The middleware's too: a fast thread would otherwise wait for a slow one that holds the
    interpreter.

    Parameters
    ----------
    priority : int
        Priority of SCHED_FIFO, 1 to 99.
    """
    with suppress(OSError):
        for task in Path('/proc/self/task').iterdir():
            if os.sched_getparam(int(task.name)).sched_priority < priority:
                set_realtime_priority(int(task.name), priority)


def lateness(seconds: float, tick_s: float) -> list[float]:
    """Return how late [s] this thread wakes from waits of `tick_s`, repeated for `seconds`.

    A dead-man switch that waits like this adds that delay to its own times.

    Parameters
    ----------
    seconds : float
        Duration of the test [s].
    tick_s : float
        Length of a wait [s].

    Returns
    -------
    list of float
        Delay of each wait [s].
    """
    waiting, late = threading.Event(), []
    end = time.monotonic() + seconds
    while (begin := time.monotonic()) < end:
        waiting.wait(tick_s)
        late.append(time.monotonic() - begin - tick_s)
    return late


@contextmanager
def realtime_priority(priority: int) -> Iterator[None]:
    """Context in which all threads have at least this `priority` (SCHED_FIFO).

    Parameters
    ----------
    priority : int
        Priority of SCHED_FIFO, 1 to 99.

    Yields
    ------
    None
        Nothing; the context has no value.
    """
    set_realtime_priority_of_all(priority)
    try:
        yield
    finally:
        with suppress(OSError):
            for task in Path('/proc/self/task').iterdir():
                os.sched_setscheduler(int(task.name), os.SCHED_OTHER, os.sched_param(0))
