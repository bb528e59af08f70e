"""Calls with a deadline: a call that hangs is abandoned, and the loop goes on."""

from __future__ import annotations

import ctypes
import queue
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

T = TypeVar('T')

SWITCH_INTERVAL = 1e-4
"""Choice: time [s] that a thread may keep the interpreter while another waits for it."""


class LateError(Exception):
    """A call missed its deadline; it continues, and nothing else is started meanwhile."""


class BusyError(LateError):
    """An earlier call has not returned yet; this one was not started."""

    def __init__(self) -> None:
        super().__init__('is still computing the previous command')


class HungError(Exception):
    """A call has not returned for so long that it was abandoned."""


class Call(Generic[T]):
    """A call of `function`, its start time and its result.

    Parameters
    ----------
    function : callable
        Function without arguments.
    """

    def __init__(self, function: Callable[[], T]) -> None:
        self.function = function
        self.begun = time.monotonic()
        self.returned = threading.Event()
        self.error: BaseException | None = None
        self.value: T

    def run(self) -> None:
        """Make the call and keep its value or exception."""
        try:
            self.value = self.function()
        except BaseException as error:
            self.error = error
        self.returned.set()


class DeadlineWorker:
    """Thread that makes calls for another, which waits only until a deadline.

    A late call continues, and nothing else is started until it returns. After `patience` [s] it is
    abandoned: its thread is made to end as soon as Python code runs in it again, and the next call
    gets a new thread. A call that holds the interpreter lock in foreign code stops the whole
    process; against that only the dead-man switch in the coil driver helps.

    Parameters
    ----------
    patience : float
        Time [s] after which a call is abandoned.
    """

    def __init__(self, patience: float) -> None:
        # A waiting thread gets the interpreter back from a computing one only this often; Python's
        # default of 5 ms would add to every deadline.
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL))
        self._patience = patience
        self._calls: queue.SimpleQueue[Call | None]
        self._thread: threading.Thread | None = None
        self._end: Callable[[], object] | None = None
        """Lets the thread end after its call; called when the worker is forgotten too."""
        self._waited_for: Call | None = None
        self._newest: Call | None = None

    def call(self, function: Callable[[], T], deadline: float) -> T:
        """Return the value of `function()`, or raise what it raises.

        Raises LateError after `deadline` [s], or at once if an earlier call still runs, and
        HungError if that one has now been abandoned.

        Parameters
        ----------
        function : callable
            Function without arguments, called in the thread of the worker.
        deadline : float
            Time [s] after which LateError is raised.

        Returns
        -------
        T
            Value that the function returned.
        """
        self._check_last()
        self._waited_for = call = self.post(function)
        if not call.returned.wait(deadline):
            raise LateError(f'took longer than {deadline * 1e3:g} ms')
        if isinstance(call.error, Exception):
            raise call.error
        if call.error is not None:  # SystemExit must not end the loop
            raise RuntimeError(f'raised {type(call.error).__name__}') from call.error
        return call.value

    def post(self, function: Callable[[], T]) -> Call[T]:
        """Start a call of `function` without waiting for it; later calls come after it.

        Parameters
        ----------
        function : callable
            Function without arguments, called in the thread of the worker.

        Returns
        -------
        Call[T]
            Call whose `returned` is set at its end.
        """
        if self._thread is None:
            self._calls = queue.SimpleQueue()
            self._end = weakref.finalize(self, self._calls.put, None)
            self._thread = threading.Thread(target=_serve, args=(self._calls,), daemon=True)
            self._thread.start()
        self._newest = call = Call(function)
        self._calls.put(call)
        return call

    def leave_behind(self) -> None:
        """Abandon the thread: it ends at once if idle, otherwise when its call allows it."""
        busy = self._newest is not None and not self._newest.returned.is_set()
        if busy and self._thread is not None and self._thread.ident is not None:
            identity = ctypes.c_ulong(self._thread.ident)
            ctypes.pythonapi.PyThreadState_SetAsyncExc(identity, ctypes.py_object(SystemExit))
        if self._end is not None:
            self._end()
        self._thread = self._waited_for = self._newest = None

    def _check_last(self) -> None:
        last = self._waited_for
        if last is None or last.returned.is_set():
            return
        waited = time.monotonic() - last.begun
        if waited > self._patience:
            self.leave_behind()
            raise HungError(f'did not return for {waited:.1f} s')
        raise BusyError()


class UnhurriedWorker(DeadlineWorker):
    """Worker that makes calls in the calling thread, for as long as they take."""

    def call(self, function: Callable[[], T], deadline: float) -> T:
        return function()

    def post(self, function: Callable[[], T]) -> Call[T]:
        call = Call(function)
        call.run()
        return call

    def leave_behind(self) -> None:
        """Do nothing: there is no thread."""


def _serve(calls: queue.SimpleQueue[Call | None]) -> None:
    with suppress(SystemExit):  # the order to end may arrive between two calls
        while (call := calls.get()) is not None:
            call.run()
            del call  # its exception would keep every frame up to the caller's until the next call
