"""Experiments as one recording: the same particles on one clock, with breaks between."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ros.records import Commands, Session, Tracks

SETTLING = 1.0
"""Seconds after an experiment has begun that are not looked at: the headings come from what was
commanded before, which is not part of it."""


def join(experiments: Sequence[Session]) -> Session:
    """`experiments` on one clock, in their order, as one session with breaks between.

    Particles keep their ids, and with them v and φ; what counts time goes on through the pauses.
    The field of a pause is not told: each experiment's first command holds back to the last frame
    of the one before, and the frames in which headings find into it (SETTLING) are left out. So
    are those after the last command let go at an experiment's end. ValueError for none, and where
    one begins before the one before ended.
    """
    if not experiments:
        raise ValueError('expected at least one experiment')
    tracks, commands, breaks, last = [], [], [], -np.inf
    for number, one in enumerate(experiments):
        begin, end = _driven(one)
        keep = (one.tracks.t >= begin + (SETTLING if number else 0.0)) & (one.tracks.t < end)
        if not keep.any():
            continue
        t = one.tracks.t[keep]
        if t[0] <= last:
            raise ValueError(f'experiment {number + 1} begins before the one before has ended')
        rows = one.commands.index_at(begin)
        inside = np.arange(len(one.commands.t)) >= max(int(rows), 0)
        inside &= one.commands.t < end
        start = one.commands.t[inside]
        if np.isfinite(last):
            breaks.append(t[0])
            start = np.concatenate([[(last + t[0]) / 2], start[1:]])
        commands.append(Commands(
            start, one.commands.field[inside],
            None if one.commands.frequency is None else one.commands.frequency[inside]))
        tracks.append(Tracks(*(getattr(one.tracks, name)[keep] for name in (
            't', 'particle', 'position', 'theta', 'sigma'))))
        last = float(t[-1])
    if not tracks:
        raise ValueError('expected frames under a field in one experiment at least')
    return Session(_tracks(tracks), _commands(commands), experiments[0].conditions, 'experiments',
                   np.array(breaks))


def _driven(one: Session) -> tuple[float, float]:
    """From when on the field flows in an experiment, and until when [s]; never: both 0."""
    on = np.hypot(*one.commands.field.T) > 0
    if not on.any():
        return 0.0, 0.0
    first, final = np.flatnonzero(on)[[0, -1]]
    end = one.commands.t[final + 1] if final + 1 < len(on) else np.inf
    return float(one.commands.t[first]), float(end)


def _tracks(parts: Sequence[Tracks]) -> Tracks:
    return Tracks(*(np.concatenate([getattr(part, name) for part in parts]) for name in (
        't', 'particle', 'position', 'theta', 'sigma')))


def _commands(parts: Sequence[Commands]) -> Commands:
    turns = [part.frequency for part in parts if part.frequency is not None]
    return Commands(
        np.concatenate([part.t for part in parts]), np.concatenate([part.field for part in parts]),
        np.concatenate(turns) if turns else None)
