"""What the commands of a session can and cannot teach about the particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.records import Commands

_SAME_LEVEL = 0.02
"""Values closer than this share of the largest are one level."""
_SPREAD = 0.5
"""Circular variance below which the directions count as bunched; 1 is even, 0 is one."""
_ONE_SENSE = 0.95
_STEP = 1e-3
"""Turns smaller than this [rad] are read-back noise, not turns."""


@dataclass(frozen=True)
class Excitation:
    """The spread of the commands over the time that particles were seen.

    `off_share` of that time nothing was commanded; `direction_variance` is circular, weighted by
    time: 0 for one direction, 1 for all alike; `magnitudes_mT` and `frequencies_hz` are the
    levels used; `turns_left` and `turns_right` count changes of direction.
    """

    rows: int
    off_share: float
    direction_variance: float
    magnitudes_mT: tuple[float, ...]
    frequencies_hz: tuple[float, ...]
    turns_left: int
    turns_right: int

    def sentences(self) -> list[str]:
        """What a person should know before fitting, and what to do about it."""
        if self.off_share > 1 - 1e-9:
            return ['No field was commanded: only drift and diffusion can be learnt.']
        said = []
        if self.direction_variance < _SPREAD:
            said.append(
                'The directions are bunched: the offset of the heading cannot be told from a '
                'drift; command directions all around the circle.')
        else:
            said.append('The directions cover the circle.')
        turns = self.turns_left + self.turns_right
        if turns and max(self.turns_left, self.turns_right) >= _ONE_SENSE * turns:
            said.append(
                'The direction turns one way only: the offset of the heading cannot be told from '
                'a delay; turn both ways.')
        levels = self.frequencies_hz or self.magnitudes_mT
        if len(levels) < 2:
            what = 'frequency' if self.frequencies_hz else 'magnitude'
            said.append(f'One {what} only: what depends on it cannot be seen; use at least two.')
        return said


def excitation(commands: Commands, start: float, end: float) -> Excitation:
    """The excitation by commands between two times [s]."""
    edges = np.clip(np.append(commands.t, np.inf), start, end)
    held = np.diff(edges)
    bx, by = commands.field.T
    magnitude, angle = np.hypot(bx, by), np.arctan2(by, bx)
    frequency = commands.frequency
    on = (magnitude > 0) & (held > 0)
    if frequency is not None:
        on &= frequency != 0
    time_on = held[on].sum()
    resultant = abs((held[on] * np.exp(1j * angle[on])).sum()) / time_on if time_on else 1.0
    turn = np.angle(np.exp(1j * np.diff(angle[on])))
    return Excitation(
        rows=len(commands.t), off_share=float(1 - time_on / (end - start)) if end > start else 1.0,
        direction_variance=float(1 - resultant), magnitudes_mT=_levels(magnitude[on] * 1e3),
        frequencies_hz=() if frequency is None else _levels(frequency[on]),
        turns_left=int((turn > _STEP).sum()), turns_right=int((turn < -_STEP).sum()),
    )


def _levels(values: np.ndarray) -> tuple[float, ...]:
    """The distinct levels among values, ascending; what is nearly the same is one."""
    ordered = np.sort(values)
    width = _SAME_LEVEL * np.abs(ordered).max(initial=0.0)
    levels = []
    while len(ordered):
        size = np.searchsorted(ordered, ordered[0] + width, side='right')
        levels.append(float(f'{np.median(ordered[:size]):.4g}'))
        ordered = ordered[size:]
    return tuple(levels)
