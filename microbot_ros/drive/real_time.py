"""Threads that come before all others of the machine, where the system grants that."""

from __future__ import annotations

import os

_PRIORITY = 10


def hurry(process: int = 0) -> bool:
    """Let this thread, and those it starts from now on, run in real time; False where not granted.

    With a `process` id the main thread of that one.

    One thread of a process is not enough: it waits for whoever holds the interpreter's lock.
    """
    try:
        os.sched_setscheduler(process, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (AttributeError, OSError):
        return False
    return True
