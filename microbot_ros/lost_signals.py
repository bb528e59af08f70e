"""Signals whose exception came where none is heard: they are sent once more."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_AGAIN_S = 0.01
"""After so long a signal that was lost is sent again."""


@contextmanager
def sent_again(number_of: Callable[[BaseException | None], int | None]) -> Iterator[None]:
    """In here, send a signal again to the main thread if its handler's exception was lost.

    No exception leads out of `__del__`, nor out of what a library in C calls back, and compilers
    of code do much of both. `number_of` gives the signal that an exception stands for, None for
    any other exception, and sees to it that the handler raises once more.
    """
    before = sys.unraisablehook
    repetitions: list[threading.Timer] = []
    one_waits = threading.Event()

    def hook(lost: sys.UnraisableHookArgs) -> None:
        number = number_of(lost.exc_value)
        if number is None:
            before(lost)
        elif not one_waits.is_set():
            one_waits.set()
            repetitions.append(threading.Timer(_AGAIN_S, send, [number]))
            repetitions[-1].start()

    def send(number: int) -> None:
        one_waits.clear()  # first: what is sent now may be lost as well
        signal.pthread_kill(threading.main_thread().ident or 0, number)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
        for repetition in repetitions:
            repetition.join()
