"""Signals whose exception was lost on its way: they are sent once more."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import weakref
from typing import TypeVar

_AGAIN_S = 0.01
"""After so long a signal that was lost is sent again."""

E = TypeVar('E', bound=BaseException)


class SentAgain:
    """In this context a signal whose exception is lost is sent to the main thread again.

    No exception leads out of `__del__`, nor out of what a library in C calls back, and some
    libraries in C clear whatever was raised while they looked for something. Compilers of code do
    much of all that. An exception on its way is held by somebody; one that nobody holds any
    more was lost, or has been dealt with: who deals with it in this context sees to it that the
    handler does not raise again.
    """

    def __init__(self) -> None:
        self._gate = threading.Lock()
        self._over = threading.Event()
        self._raised: dict[int, weakref.ref[BaseException]] = {}

    def __enter__(self) -> SentAgain:
        self._hook_before = sys.unraisablehook
        sys.unraisablehook = self._hook
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        with self._gate:  # whoever is sending has done so
            pass
        sys.unraisablehook = self._hook_before

    @property
    def on_its_way(self) -> bool:
        """Whether an exception of a signal is still held by somebody."""
        return bool(self._raised)

    def watched(self, number: int, error: E) -> E:
        """The `error` for the handler of signal `number` to raise; of a class made in Python,
        since others can't be watched.
        """
        key = id(error)

        def lost(_: object) -> None:
            # Not threading.Thread: whoever holds its lock in this moment may be interrupted here.
            if self._raised.pop(key, None) and not self._over.is_set():
                _thread.start_new_thread(self._send, (number,))

        self._raised[key] = weakref.ref(error, lost)
        return error

    def _send(self, number: int) -> None:
        # One after the other, so that the next sees what came of the one before: a second
        # Ctrl-C that nobody pressed would end the clean-up.
        with self._gate:
            self._over.wait(_AGAIN_S)
            if not self._over.is_set() and not self.on_its_way:
                signal.pthread_kill(threading.main_thread().ident or 0, number)

    def _hook(self, lost: sys.UnraisableHookArgs) -> None:
        if id(lost.exc_value) not in self._raised:
            self._hook_before(lost)
