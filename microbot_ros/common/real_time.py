"""Threads that come before all others of the machine, where the system grants that."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SAFETY, LOOP = 10, 5
"""Priorities: of what zeroes the coils, and of the rest of the closed loop."""


def set_realtime_priority(thread: int = 0, priority: int = SAFETY) -> bool:
    """Let this thread, and those it starts from now on, run in real time; False where not granted.

    With the id of another `thread`, that one; the id of a process is that of its main thread.
    `priority` is of SCHED_FIFO, 1 to 99.
    """
    try:
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError):
        return False
    return True


def set_realtime_priority_of_all(priority: int) -> None:
    """`set_realtime_priority` with a `priority` for all threads of this process that have less.

    Those of the middleware too: one is not enough, it waits for who holds the interpreter's lock.
    """
    with suppress(OSError):
        for task in Path('/proc/self/task').iterdir():
            if os.sched_getparam(int(task.name)).sched_priority < priority:
                set_realtime_priority(int(task.name), priority)


def lateness(seconds: float, tick_s: float) -> list[float]:
    """How late [s] this thread wakes from waits of `tick_s`, one after the other for `seconds`.

    A dead-man that waits like this is that late, beside its own times.
    """
    waiting, late = threading.Event(), []
    end = time.monotonic() + seconds
    while (begin := time.monotonic()) < end:
        waiting.wait(tick_s)
        late.append(time.monotonic() - begin - tick_s)
    return late


@contextmanager
def realtime_priority(priority: int) -> Iterator[None]:
    """`set_realtime_priority_of_all` with a `priority` for as long as this lasts."""
    set_realtime_priority_of_all(priority)
    try:
        yield
    finally:
        with suppress(OSError):
            for task in Path('/proc/self/task').iterdir():
                os.sched_setscheduler(int(task.name), os.SCHED_OTHER, os.sched_param(0))
