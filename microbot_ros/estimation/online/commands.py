"""The commands so far, as the online filter remembers them."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.records import Commands

NEGLIGIBLE = 1e-5
"""A field weaker than this [T], a fifth of the earth's, is noise of a read-back."""

SET_BACK = 1.0
"""A clock that goes back by more than this [s] has been started anew."""

STRONGEST, FASTEST_TURN = 1e3, 1e6
"""Fields [T] and frequencies [Hz] beyond these are no commands, whoever sends them."""


class CommandLog:
    """Commands as they arrive, in order of time, kept for as long as they matter."""

    _ROOM = 256

    def __init__(self) -> None:
        self._rows = np.empty((self._ROOM, 4))
        self._count = 0

    def append(self, t: float, field: np.ndarray, frequency: float | None = None) -> str:
        """Add a command in force from `t` [s]; the reason it was refused, or ''.

        `field` (2,) [T], taken for zero below NEGLIGIBLE; `frequency` [Hz] of rollers. Refused
        are numbers that are not finite or beyond all coils, and commands earlier than the last.
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
        """What is kept, a view (K, 4): time [s], field [T] and frequency [Hz] of each command."""
        return self._rows[:self._count]

    @property
    def last(self) -> float:
        """Time of the newest command [s]; −inf where there is none."""
        return float(self._rows[self._count - 1, 0]) if self._count else -np.inf

    def since(self, t: float, delay: float = 0.0) -> Commands:
        """What an integration from time `t` [s] on needs, all `delay` [s] later than commanded.

        The command in force at `t` and all after it. Where the one in force is zero field, the
        last field that was not zero comes first: headings stay where it left them.
        """
        rows = self._in_force(t - delay)
        return Commands(rows[:, 0] + delay, rows[:, 1:3], rows[:, 3])

    def forget_before(self, t: float) -> None:
        """Drop what `since(t)` [s] would not give, once that is many commands."""
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
