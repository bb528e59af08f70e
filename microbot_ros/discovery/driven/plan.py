"""Plan of an experiment: a sequence of fields, each held for a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.records import Commands

MARKING, STEP = 60.0, 1.5
"""Duration [s] for which particles are kept in place at most, and of a side of the square
(`STEP`).

Choice: longer than any look, on a square of a few body lengths."""


@dataclass(frozen=True)
class Plan:
    """Sequence of S fields.

    Attributes
    ----------
    angle : ndarray, shape (S,)
        Directions [rad].
    strength : ndarray, shape (S,)
        Fields [T]; 0 for no field.
    hold : ndarray, shape (S,)
        Durations [s].
    frequency : ndarray, shape (S,), or None
        Frequencies of a rolling field [Hz]; None for swimmers.

    Raises
    ------
    ValueError
        For rows of different lengths or none, numbers that are not finite, negative strengths or
        frequencies, or holds that are not positive.
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
        """Total duration [s]."""
        return float(self.hold.sum())

    def commands(self, start: float = 0.0) -> Commands:
        """Return the fields as commands.

        Parameters
        ----------
        start : float, optional
            Time of the first field [s].

        Returns
        -------
        Commands
            The last field stays in force.
        """
        t = start + np.cumsum(self.hold) - self.hold
        field = self.strength[:, None] * np.column_stack([np.cos(self.angle), np.sin(self.angle)])
        return Commands(t, field, self.frequency)

    def lasting(self, seconds: float) -> Plan:
        """Return the plan cut or repeated to a duration.

        Parameters
        ----------
        seconds : float
            Duration [s].

        Returns
        -------
        Plan
            Of exactly that duration.
        """
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
        """Return this plan followed by another.

        Parameters
        ----------
        other : Plan
            Plan for particles of the same kind.

        Returns
        -------
        Plan
            Both, one after the other.
        """
        return Plan(*(
            None if row is None or next_ is None else np.concatenate([row, next_])
            for row, next_ in zip(self._rows, other._rows, strict=True)))  # type: ignore[arg-type]

    @property
    def _rows(self) -> tuple[np.ndarray | None, ...]:
        return self.angle, self.strength, self.hold, self.frequency

    def sentence(self) -> str:
        """Return the plan in a few words: turns, holds and strengths.

        Returns
        -------
        str
            As `turning by 90° every 2 s, for 10 s`.
        """
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
    """Return a plan that keeps swimmers in place: a small square, for at most MARKING seconds.

    Swimmers that are left alone swim away while the next plan is computed. The square never turns
    back: a heading that lags behind the field is in balance opposite to it, and chance decides
    which way it then turns, which no model predicts. (To and fro, a second effect was falsely
    named in 7 of 10 simulated worlds; round the square in none of 12.)

    Parameters
    ----------
    last : float
        Last direction [rad], from which the square continues.
    strength : float
        Field [T].
    frequency : float, optional
        Frequency of a rolling field [Hz].

    Returns
    -------
    Plan
        Quarter turns every STEP seconds.
    """
    count = round(MARKING / STEP)
    return Plan(last + np.pi / 2 * (1 + np.arange(count)), np.full(count, strength),
                np.full(count, STEP), None if frequency is None else np.full(count, frequency))
