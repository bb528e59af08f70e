"""End of our processes: by a signal, or because the launching process is gone."""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from microbot_ros.common.real_time import set_realtime_priority

PARENT = 'MICROBOT_PARENT'
"""Environment variable with the process id that a node must not outlive; 0 for none."""


_HEAD_START_S = 0.1
"""Choice: time that an interrupted thread waits for `at_once`.

Its clean-up may hold the interpreter for as long as the middleware takes to shut down.
"""

_LOOK_S = 0.1
"""Interval [s] at which the launcher is looked for where the system cannot tell of its end.

Choice: as long as coils outlive a node that was killed.
"""


class Stopped(BaseException):
    """A signal of this `number` asked the process to end.

    No subclass of Exception, so that no handler swallows it.

    Parameters
    ----------
    number : int
        Number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number
        """Exit status that shells give to a process ended by this signal."""


def find_launcher() -> int | None:
    """Return the id of the process that this one must not outlive, or None.

    `microbot` and our launch files name it in the environment. `ros2` does not; its children are
    recognised by their parent. A node started from a shell, in the background or with `nohup` or
    `setsid`, survives the shell.

    Returns
    -------
    int or None
        Process id, or None.
    """
    named = os.environ.get(PARENT)
    if named:
        return int(named) or None
    parent = os.getppid()
    with suppress(OSError):
        words = Path(f'/proc/{parent}/cmdline').read_bytes().split(b'\0')
        if any(Path(os.fsdecode(word)).name == 'ros2' for word in words[:2]):
            return parent
    return None


class Ending:
    """Context of the main thread that notices at once when this process is to end.

    SIGINT, SIGTERM, SIGHUP (unless ignored from the start, as by `nohup`) and the end of the
    process `launcher` set `due` and call `at_once` in a separate thread. A Python signal handler
    would wait until the main thread returns from the library that it is in, and could not take a
    lock that the main thread holds.

    Parameters
    ----------
    at_once : callable
        Function that is called at the end.
    launcher : int or None
        Process whose end ends this one too; None for none.
    """

    def __init__(self, at_once: Callable[[], None] = lambda: None,
                 launcher: int | None = None) -> None:
        self.due = False
        self._at_once = at_once
        self._launcher = launcher
        self._received: int | None = None
        self._interruptible = False
        self._over = False
        self._done_at_once = threading.Event()

    def __enter__(self) -> Ending:
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._wakeup_before = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        self._handlers_before = {
            number: signal.signal(number, self._handle)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN}
        self._thread = threading.Thread(target=self._watch, name='ending', daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers_before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup_before)
        self._over = True
        os.write(self._writer, b'\0')
        self._thread.join()
        os.close(self._reader)
        os.close(self._writer)

    @contextmanager
    def interrupts(self) -> Iterator[None]:
        """Context in which a signal raises Stopped; outside it, as in clean-up, none interrupts.

        A library in C may swallow the exception; `due` and `at_once` do not depend on it.

        Yields
        ------
        None
            Nothing; the context has no value.
        """
        try:
            self._interruptible = True
            if self._received is not None:
                raise Stopped(self._received)
            yield
        finally:
            self._interruptible = False

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self._received is None:
            self._received = number
        if self._interruptible:
            self._done_at_once.wait(_HEAD_START_S)
            raise Stopped(self._received)

    def _watch(self) -> None:
        """Wait, in a thread, for a signal or for the end of the launcher."""
        set_realtime_priority()
        try:
            self._await_end()
        finally:  # a failure is an end, too
            if not self._over:
                self.due = True
                self._at_once()
                self._done_at_once.set()

    def _await_end(self) -> None:
        awaited, look_s = [self._reader], None
        if self._launcher is not None:
            try:
                awaited.append(os.pidfd_open(self._launcher))
            except ProcessLookupError:
                return  # the launcher had already ended
            except OSError:  # an old kernel, a sandbox, or no descriptor left
                look_s = _LOOK_S
        while not select.select(awaited, [], [], look_s)[0]:
            try:
                os.kill(self._launcher or 0, 0)
            except ProcessLookupError:
                return
            except OSError:
                continue  # a process of somebody else
        for process in awaited[1:]:
            os.close(process)
