"""Experiments joined to one session: the same particles on one clock, with breaks at pauses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from microbot_ros.common.records import Commands, Session, Tracks

PAUSE = 1.0
"""Time [s] without frames above which a session has a break.

Choice: longer than gaps of tracking, shorter than the time between two experiments.
"""

SETTLING = 2.0
"""Time [s] after a pause that is left out.

The commands during the pause are not recorded, and headings depend on them. Choice: longer than
usual alignment times.
"""

TINY = 1e-4
"""Time [s] after a frame at which the field in force there is recorded. Choice: below any
interval."""


def join(experiments: Sequence[Session]) -> Session:
    """Join experiments to one session on one clock.

    Particles keep their ids, and with them v and φ; age and time continue. Where an experiment
    begins more than PAUSE after the one before, there is a break: frames within SETTLING are left
    out, and the first field holds back to the last frame before. Frames after the last field of an
    experiment are left out too. Of a frame that two experiments have, the second is kept.

    Parameters
    ----------
    experiments : sequence of Session
        In order of time.

    Returns
    -------
    Session
        With breaks.

    Raises
    ------
    ValueError
        If no frame has a field, or an experiment begins before the one before has ended.
    """
    tracks: list[Tracks] = []
    commands: list[Commands] = []
    breaks: list[float] = []
    last = -np.inf
    for number, one in enumerate(experiments, 1):
        begin, end = _driven(one)
        whole = _between(one.tracks, begin, end)
        if len(whole.t) and whole.t[0] < last:
            raise ValueError(f'experiment {number} begins before the previous one has ended')
        whole = _between(whole, np.nextafter(last, np.inf), end)
        if not len(whole.t):
            continue
        told = _in_force(one.commands, max(begin, last), end)
        if np.isfinite(last) and whole.t[0] - last > PAUSE:
            whole = _between(whole, begin + SETTLING, end)
            told = replace(told, t=np.append((last + begin) / 2, told.t[1:]))
            breaks.append(begin)
        if len(whole.t):
            tracks.append(whole)
            commands = [_rows(part, 0, told.t[0]) for part in commands] + [told]
            last = float(whole.t[-1])
    if not tracks:
        raise ValueError('expected frames under a field in one experiment at least')
    names = ('t', 'particle', 'position', 'theta', 'sigma')
    turns = [part.frequency for part in commands if part.frequency is not None]
    return Session(
        Tracks(*(np.concatenate([getattr(part, name) for part in tracks]) for name in names)),
        Commands(np.concatenate([part.t for part in commands]),
                 np.concatenate([part.field for part in commands]),
                 np.concatenate(turns) if turns else None),
        experiments[0].conditions, 'experiments', np.array(breaks))


def _driven(one: Session) -> tuple[float, float]:
    """Return when the field begins and ends in an experiment [s]; both 0 for no field."""
    on = np.hypot(*one.commands.field.T) > 0
    if not on.any():
        return 0.0, 0.0
    first, final = np.flatnonzero(on)[[0, -1]]
    end = one.commands.t[final + 1] if final + 1 < len(on) else np.inf
    return float(one.commands.t[first]), float(end)


def _between(tracks: Tracks, begin: float, end: float) -> Tracks:
    return tracks.rows((tracks.t >= begin) & (tracks.t < end))


def _in_force(commands: Commands, begin: float, end: float) -> Commands:
    """Return the rows in force after `begin` [s], from then on, and before `end` [s]."""
    told = _rows(commands, max(int(commands.index_at(begin)), 0), end)
    t = told.t.copy()
    t[:1] = np.maximum(t[:1], begin + TINY)
    return replace(told, t=t)


def _rows(commands: Commands, first: int, end: float) -> Commands:
    """Return rows from index `first` on, before `end` [s]."""
    rows = slice(first, int(np.searchsorted(commands.t, end)))
    return Commands(commands.t[rows], commands.field[rows],
                    None if commands.frequency is None else commands.frequency[rows])
