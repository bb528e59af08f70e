"""Workers that record how their calls ended, and that repeat such a record."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from microbot_ros.control.deadline_worker import (
    BusyError,
    DeadlineWorker,
    HungError,
    LateError,
    T,
    UnhurriedWorker,
)

IN_TIME, LATE, BUSY, HUNG = 't', 'l', 'b', 'h'
"""Ends of a call: in time; too late, its value unused; not started while an earlier one ran; not
started, and the earlier one abandoned.
"""


class NotingWorker(DeadlineWorker):
    """Worker with a `patience` [s] that passes the end of each call, a letter, to `note`.

    Parameters
    ----------
    patience : float
        Time [s] after which a call is abandoned.
    note : callable
        Function that is called with the letter.
    """

    def __init__(self, patience: float, note: Callable[[str], None]) -> None:
        super().__init__(patience)
        self._note = note

    def call(self, function: Callable[[], T], deadline: float) -> T:
        letter = IN_TIME
        try:
            return super().call(function, deadline)
        except HungError:
            letter = HUNG
            raise
        except BusyError:
            letter = BUSY
            raise
        except LateError:
            letter = LATE
            raise
        finally:
            self._note(letter)


class RepeatingWorker(UnhurriedWorker):
    """Worker with a `patience` [s] whose calls end as `letter()` says, without a deadline.

    Parameters
    ----------
    patience : float
        Time [s] after which a call is abandoned.
    letter : callable
        Function that returns the letter.
    """

    def __init__(self, patience: float, letter: Callable[[], str]) -> None:
        super().__init__(patience)
        self._letter = letter

    def call(self, function: Callable[[], T], deadline: float) -> T:
        letter = self._letter()
        if letter == BUSY:
            raise BusyError()
        if letter == HUNG:
            raise HungError(f'did not return for {self._patience:g} s')
        if letter == LATE:
            with suppress(Exception):
                function()
            raise LateError(f'took longer than {deadline * 1e3:g} ms')
        return function()
