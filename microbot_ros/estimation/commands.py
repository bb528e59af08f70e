"""The commands so far, and what a model makes of them between frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.increments import Response, respond
from microbot_ros.model.model import Model
from microbot_ros.model.timeline import Timeline
from microbot_ros.records import Commands

NEGLIGIBLE = 1e-5
"""A field weaker than this [T], a fifth of the earth's, is noise of a read-back."""


class CommandLog:
    """Commands as they arrive, in order of time, kept for as long as they matter."""

    _ROOM = 256

    def __init__(self) -> None:
        self._rows = np.empty((self._ROOM, 4))
        self._count = 0

    def append(self, t: float, field: np.ndarray, frequency: float | None = None) -> str:
        """Add a command; the reason it was refused, or ''."""
        row = np.array([t, field[0], field[1], 0.0 if frequency is None else frequency], float)
        if not np.isfinite(row).all():
            return 'a command holds numbers that are not finite: ignored'
        if np.hypot(row[1], row[2]) < NEGLIGIBLE:
            row[1:3] = 0
        if self._count and not t >= self.last:
            return f'a command is stamped {self.last - t:.3g} s before the one before it: ignored'
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = row
        self._count += 1
        return ''

    @property
    def last(self) -> float:
        """Time of the newest command [s]; −inf where there is none."""
        return float(self._rows[self._count - 1, 0]) if self._count else -np.inf

    def since(self, t: float, delay: float = 0.0) -> Commands:
        """Commands delayed by `delay` [s]: the one in force at `t`, those after it and, where that
        one is no field, before them the last field, which rules the heading."""
        rows = self._ruling(t - delay)
        return Commands(rows[:, 0] + delay, rows[:, 1:3], rows[:, 3])

    def forget_before(self, t: float) -> None:
        """Drop what no longer matters to frames from `t` on, when it has become much."""
        kept = self._ruling(t)
        if self._count - len(kept) > self._ROOM:
            self._rows, self._count = kept.copy(), len(kept)

    def _ruling(self, t: float) -> np.ndarray:
        rows = self._rows[:self._count]
        first = max(int(np.searchsorted(rows[:, 0], t, side='right')) - 1, 0)
        if rows[first:first + 1, 1:3].any():
            return rows[first:]
        steering = np.flatnonzero(rows[:first, 1:3].any(axis=1))
        return np.concatenate([rows[steering[-1:]], rows[first:]])


@dataclass(frozen=True)
class Paths:
    """What moves particles with c = v e^{iφ}: p(t) = p₀ + c·`drive` + `drift`, both complex.

    `drive` (T, 1 or N) [s, or cycles] and `drift` (T, 1 or N) [m], zero at the first time.
    """

    drive: np.ndarray
    drift: np.ndarray


def paths(response: Response) -> Paths:
    """The accumulated response, over the frames of its timeline."""
    moved = response.drift[..., 0] + 1j * response.drift[..., 1]
    return Paths(*(
        np.concatenate([np.zeros((1, steps.shape[1]), complex), np.cumsum(steps, axis=0)])
        for steps in (response.propulsion, moved)
    ))


def model_paths(
    model: Model, commands: Commands, times: np.ndarray, positions: np.ndarray | None = None,
) -> Paths:
    """The paths of a model at `times` (T,); `positions` (T, N, 2) only where it needs them."""
    return paths(respond(model, Timeline(commands, times, positions)))
