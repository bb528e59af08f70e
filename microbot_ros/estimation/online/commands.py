"""Log of commands for the online filter."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.records import Commands

NEGLIGIBLE = 1e-5
"""Field [T] below which a command is zero: a fifth of the Earth's field.

Choice: above the noise of a read-back, below any field that aligns particles.
"""

SET_BACK = 1.0
"""Time [s] by which a clock must go back to count as restarted. Choice: above any jitter of
stamps."""

STRONGEST, FASTEST_TURN = 1e3, 1e6
"""Largest field [T] and frequency [Hz] (`FASTEST_TURN`) of a command.

Choice: beyond any coils; larger numbers are errors of the sender.
"""


class CommandLog:
    """Commands in order of time, kept for as long as they matter."""

    _ROOM = 256
    """Rows by which storage grows, and superfluous rows that are kept. Choice: minutes of
    commands."""

    def __init__(self) -> None:
        self._rows = np.empty((self._ROOM, 4))
        self._count = 0

    def append(self, t: float, field: np.ndarray, frequency: float | None = None) -> str:
        """Add a command.

        Refused are numbers that are not finite or beyond all coils, and commands earlier than the
        last.

        Parameters
        ----------
        t : float
            Time from which it is in force [s].
        field : ndarray, shape (2,)
            Field [T]; zero below NEGLIGIBLE.
        frequency : float, optional
            Frequency of rollers [Hz].

        Returns
        -------
        str
            Why the command was refused; '' if it was not.
        """
        x, y, turns = float(field[0]), float(field[1]), frequency or 0.0
        if not all(map(math.isfinite, (t, x, y, turns))):
            return 'a command has numbers that are not finite: ignored'
        if max(abs(x), abs(y)) > STRONGEST or abs(turns) > FASTEST_TURN:
            return f'a command of {x:.3g}, {y:.3g} T, {turns:.3g} Hz exceeds any coils: ignored'
        if math.hypot(x, y) < NEGLIGIBLE:
            x = y = 0.0
        if self._count and not t >= self.last:
            return f'a command is stamped {self.last - t:.3g} s before the one before it: ignored'
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = t, x, y, turns
        self._count += 1
        return ''

    @property
    def rows(self) -> np.ndarray:
        """All kept commands as a view (K, 4): time [s], field [T] and frequency [Hz]."""
        return self._rows[:self._count]

    @property
    def last(self) -> float:
        """Time of the newest command [s]; −inf if there is none."""
        return float(self._rows[self._count - 1, 0]) if self._count else -np.inf

    def since(self, t: float, delay: float = 0.0) -> Commands:
        """Return the commands that an integration from a time on needs.

        They are the command in force then, and all later ones. If the field in force is zero, the
        last field that was not zero comes first: headings stay where it left them.

        Parameters
        ----------
        t : float
            Time [s].
        delay : float, optional
            Delay added to all commands [s].

        Returns
        -------
        Commands
            The commands.
        """
        rows = self._in_force(t - delay)
        return Commands(rows[:, 0] + delay, rows[:, 1:3], rows[:, 3])

    def rests(self, start: float, end: float) -> bool:
        """Return whether no field is commanded in an interval, after one was.

        Headings then drift freely: the room's field, a wall or a neighbour turns them.

        Parameters
        ----------
        start, end : float
            Interval [s].

        Returns
        -------
        bool
            False before the first field.
        """
        rows = self.rows
        first = max(int(np.searchsorted(rows[:, 0], start, side='right')) - 1, 0)
        last = max(int(np.searchsorted(rows[:, 0], end)), first + 1)
        return bool(rows[:first, 1:3].any()) and not rows[first:last, 1:3].any()

    def forget_before(self, t: float) -> None:
        """Drop commands that `since` would not return, once these are many.

        Parameters
        ----------
        t : float
            Earliest time of later calls of `since` [s].
        """
        if 4 * self._count < 3 * len(self._rows):
            return
        kept = self._in_force(t)
        if self._count - len(kept) > self._ROOM:
            self._rows, self._count = kept.copy(), len(kept)

    def _in_force(self, t: float) -> np.ndarray:
        rows = self.rows
        first = max(int(np.searchsorted(rows[:, 0], t, side='right')) - 1, 0)
        if rows[first:first + 1, 1:3].any():
            return rows[first:]
        steering = np.flatnonzero(rows[:first, 1:3].any(axis=1))
        return np.concatenate([rows[steering[-1:]], rows[first:]])
