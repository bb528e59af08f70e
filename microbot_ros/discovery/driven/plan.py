"""A plan: a row of fields, each held for a while, that an experiment plays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.records import Commands

MARKING, STEP = 60.0, 1.5
"""Seconds for which particles are kept where they are at most, and of a side of the square."""


@dataclass(frozen=True)
class Plan:
    """Fields in a row: `angle` [rad], `strength` [T] and `hold` [s], (S,) each.

    `frequency` (S,) [Hz] of a rolling field, None for particles that swim by themselves. A
    strength of 0 lets go for that while. ValueError for rows of different lengths, none at all,
    or numbers that are not finite, negative strengths or frequencies, or holds that are not
    positive.
    """

    angle: np.ndarray
    strength: np.ndarray
    hold: np.ndarray
    frequency: np.ndarray | None = None

    def __post_init__(self) -> None:
        rows = [self.angle, self.strength, self.hold]
        rows += [] if self.frequency is None else [self.frequency]
        if len({np.shape(row) for row in rows}) != 1 or np.ndim(self.hold) != 1 or not len(
                self.hold):
            raise ValueError('a plan must have one angle, strength and hold for each of its '
                             f'fields; received {", ".join(str(np.shape(r)) for r in rows)}')
        sound = np.isfinite(rows).all() and (self.strength >= 0).all() and (self.hold > 0).all()
        if not (sound and (self.frequency is None or (self.frequency >= 0).all())):
            raise ValueError('a plan must hold finite numbers, none negative and holds above 0')

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.hold.sum())

    def commands(self, start: float = 0.0) -> Commands:
        """Its fields from `start` [s] on, the last of which holds on."""
        t = start + np.cumsum(self.hold) - self.hold
        field = self.strength[:, None] * np.column_stack([np.cos(self.angle), np.sin(self.angle)])
        return Commands(t, field, self.frequency)

    def lasting(self, seconds: float) -> Plan:
        """Its beginning, or all of it again and again, so that it takes just so many `seconds`."""
        times = max(math.ceil(seconds / self.duration - 1e-9), 1)
        long = Plan(*(None if row is None else np.tile(row, times)
                      for row in self._rows))  # type: ignore[arg-type]
        end = np.cumsum(long.hold)
        count = min(int(np.searchsorted(end, seconds - 1e-9)) + 1, len(end))
        hold = long.hold[:count].copy()
        hold[-1] -= end[count - 1] - seconds
        return replace(long, angle=long.angle[:count], strength=long.strength[:count], hold=hold,
                       frequency=None if long.frequency is None else long.frequency[:count])

    def then(self, other: Plan) -> Plan:
        """This, and an `other` after it; both for particles of one kind."""
        return Plan(*(
            None if row is None or next_ is None else np.concatenate([row, next_])
            for row, next_ in zip(self._rows, other._rows, strict=True)))  # type: ignore[arg-type]

    @property
    def _rows(self) -> tuple[np.ndarray | None, ...]:
        return self.angle, self.strength, self.hold, self.frequency

    def sentence(self) -> str:
        """What it does, in a few words: how it turns, how long it holds, at which strengths."""
        driven = self.strength > 0
        turn = np.abs((np.diff(self.angle[driven]) + np.pi) % (2 * np.pi) - np.pi)
        said = 'holding one direction'
        if turn.size:
            low, high = np.degrees(np.quantile(turn, [0.15, 0.85]))
            said = (f'turning by {np.median(np.degrees(turn)):.0f}°' if high - low < 25 else
                    f'turning by {low:.0f}° to {high:.0f}°')
        short, long = np.quantile(self.hold, [0.15, 0.85])
        said += (f' every {np.median(self.hold):.2g} s' if long < 1.5 * short else
                 f' every {short:.2g} to {long:.2g} s')
        levels = np.unique(np.round(self.strength[driven] * 1e3, 1))
        if levels.size > 1:
            said += f' at {levels[0]:g} to {levels[-1]:g} mT'
        if self.frequency is not None and len(turns := np.unique(np.round(self.frequency, 1))) > 1:
            said += f' and {turns[0]:g} to {turns[-1]:g} Hz'
        if not driven.all():
            said += f', without a field for {self.hold[~driven].sum():.0f} s'
        return f'{said}, for {self.duration:.0f} s'


def marking_time(last: float, strength: float, frequency: float | None = None) -> Plan:
    """Round a small square, on from the direction `last` [rad], at a `strength` [T], and a
    `frequency` [Hz] of rollers.

    Swimmers that are left alone swim away: this keeps them where they are, for MARKING seconds at
    most, while it is thought what to play next. It never turns back: a heading that lags behind
    the field is in balance opposite to it, and which way it then comes round is left to chance,
    of which no model can say anything.
    """
    count = round(MARKING / STEP)
    return Plan(last + np.pi / 2 * (1 + np.arange(count)), np.full(count, strength),
                np.full(count, STEP), None if frequency is None else np.full(count, frequency))
