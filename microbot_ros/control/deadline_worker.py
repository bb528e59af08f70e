"""Calls with a deadline: what hangs is left behind, and the loop goes on."""

from __future__ import annotations

import ctypes
import queue
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

T = TypeVar('T')

SWITCH_INTERVAL = 1e-4
"""How long [s] a thread may keep the interpreter while another waits for it."""


class LateError(Exception):
    """A call has not returned within its deadline; it goes on, and nothing else is begun."""


class BusyError(LateError):
    """An earlier call has not returned yet; this one was not begun."""


class HungError(Exception):
    """A call has not returned for so long that it was left behind."""


class Call(Generic[T]):
    """A call of `function`, when it was made and what came of it."""

    def __init__(self, function: Callable[[], T]) -> None:
        self.function = function
        self.begun = time.monotonic()
        self.returned = threading.Event()
        self.error: BaseException | None = None
        self.value: T

    def run(self) -> None:
        """Make it, and keep its value or what it raises."""
        try:
            self.value = self.function()
        except BaseException as error:
            self.error = error
        self.returned.set()


class DeadlineWorker:
    """One thread that makes calls for another, which waits no longer than it wants to.

    A call that is late goes on, and until it returns nothing else is begun. After `patience` [s]
    it is left behind: its thread is told to end as soon as Python code in it runs again, and the
    next call gets a new one. A call that holds the interpreter's lock in foreign code stops the
    whole process; against that only the dead-man in the coil driver helps.
    """

    def __init__(self, patience: float) -> None:
        # A thread that waits gets the interpreter back from one that computes only this often;
        # Python's default of 5 ms would come on top of every deadline.
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL))
        self._patience = patience
        self._calls: queue.SimpleQueue[Call | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._waited_for: Call | None = None
        self._newest: Call | None = None

    def call(self, function: Callable[[], T], deadline: float) -> T:
        """The value of `function()`, or what it raises.

        LateError after `deadline` [s], or at once if an earlier call still goes on; HungError
        when that one has now been left behind.
        """
        self._check_last()
        self._waited_for = call = self.post(function)
        if not call.returned.wait(deadline):
            raise LateError(f'took longer than {deadline * 1e3:g} ms')
        if isinstance(call.error, Exception):
            raise call.error
        if call.error is not None:  # a call to exit must not end the loop
            raise RuntimeError(f'raised {type(call.error).__name__}') from call.error
        return call.value

    def post(self, function: Callable[[], T]) -> Call[T]:
        """A call of `function` for which nobody waits; those made later come after it."""
        if self._thread is None:
            self._calls = queue.SimpleQueue()
            self._thread = threading.Thread(target=_serve, args=(self._calls,), daemon=True)
            self._thread.start()
        self._newest = call = Call(function)
        self._calls.put(call)
        return call

    def finished(self, call: Call[T], seconds: float) -> bool:
        """Whether a `call` that was posted returns within so many `seconds`."""
        return call.returned.wait(seconds)

    def leave_behind(self) -> None:
        """Let go of the thread: if idle it ends at once, otherwise when its call lets it."""
        busy = self._newest is not None and not self._newest.returned.is_set()
        if busy and self._thread is not None and self._thread.ident is not None:
            identity = ctypes.c_ulong(self._thread.ident)
            ctypes.pythonapi.PyThreadState_SetAsyncExc(identity, ctypes.py_object(SystemExit))
        self._calls.put(None)
        self._thread = self._waited_for = self._newest = None

    def _check_last(self) -> None:
        last = self._waited_for
        if last is None or last.returned.is_set():
            return
        waited = time.monotonic() - last.begun
        if waited > self._patience:
            self.leave_behind()
            raise HungError(f'did not return for {waited:.1f} s')
        raise BusyError('has not returned from the tick before')


class UnhurriedWorker(DeadlineWorker):
    """Calls in the thread of whoever asks, for as long as they take."""

    def call(self, function: Callable[[], T], deadline: float) -> T:
        return function()

    def post(self, function: Callable[[], T]) -> Call[T]:
        call = Call(function)
        call.run()
        return call

    def leave_behind(self) -> None:
        """There is nobody to leave."""


def _serve(calls: queue.SimpleQueue[Call | None]) -> None:
    with suppress(SystemExit):  # it may be told to end on the way into a call
        while (call := calls.get()) is not None:
            call.run()
