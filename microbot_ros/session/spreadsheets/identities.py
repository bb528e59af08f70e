"""Identity of a stretch of a sheet: trackers may change the robot of a sheet on the way.

A tracker that keeps its robots in a list writes one sheet per list position. When a robot is
deleted, those behind it move up, and their sheets jump to another robot between two rows. A lost
robot may be picked up again elsewhere, or another one in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from microbot_ros.common.records import Tracks
from microbot_ros.session.spreadsheets.sheets import Assumptions

# Choices. The usual step is the 95th percentile of a sheet's steps.
_LEAP_STEPS = 6.0
_LEAP = 10e-6
"""Choice: a step longer than both, in usual steps and in metres, is a jump.

The longest step of robots that roll at 20 Hz, over a skipped frame, is 3 usual ones.
"""
_NEAR_STEPS, _NEAR_FRAMES = 4.0, 5.0
"""Choices: usual steps and frames within which a stretch continues where another ended."""
_FEWEST = 20
"""Choice: rows needed to know the usual step of a sheet."""


@dataclass
class _Stretch:
    track: Tracks
    step: float  # that 95 of 100 stay below [m]
    interval: float
    follows: bool  # begins after a cut or a leap
    continued: bool = False

    @property
    def name(self) -> int:
        return int(self.track.particle[0])


def settle_identities(pieces: Sequence[Tracks], said: Assumptions) -> list[Tracks]:
    """Return tracks whose `pieces` have the identity of the robot that they show.

    A piece is a stretch of one sheet; several of one name were cut apart. Pieces of several robots
    are returned unchanged. After a jump or a cut, a stretch gets the identity of the robot last
    seen where it begins, else a new one. `said` notes each change.

    Parameters
    ----------
    pieces : sequence of Tracks
        Tracks of the pieces.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    list of Tracks
        Tracks with identities.
    """
    mixed = [piece for piece in pieces if len(np.unique(piece.particle)) != 1]
    stretches: list[_Stretch] = []
    for piece in pieces:
        if len(piece.t) and len(np.unique(piece.particle)) == 1:
            known = {stretch.name for stretch in stretches}
            stretches += _split(piece, int(piece.particle[0]) in known)
    if _moved_together(stretches):
        for stretch in stretches:
            stretch.follows = False
    taken = [*(stretch.name for stretch in stretches),
             *(int(name) for piece in mixed for name in np.unique(piece.particle))]
    free = max(taken, default=-1) + 1
    changes: list[str] = []
    for stretch in sorted((s for s in stretches if s.follows), key=lambda s: s.track.t[0]):
        before, at = stretch.name, float(stretch.track.t[0])
        there = _ended_there(stretches, stretch)
        if there is not None:
            name, there.continued = there.name, True
        else:
            name, free = free, free + 1
        stretch.track = replace(stretch.track, particle=np.full(len(stretch.track.t), name))
        stretch.follows = False
        if name != before:
            changes.append(f'sheet of robot {before} holds robot {name} from {at:.1f} s on'
                           + (': it is at the position of that robot' if there else ', elsewhere'))
    for change in changes:
        said.add(change)
    return [*mixed, *(stretch.track for stretch in stretches)]


def _split(piece: Tracks, follows: bool) -> list[_Stretch]:
    """Return the stretches of a `piece` between jumps."""
    steps = np.hypot(*np.diff(piece.position, axis=0).T)
    interval = float(np.median(np.diff(piece.t))) if len(piece.t) > 1 else 0.0
    if len(steps) < _FEWEST:
        return [_Stretch(piece, float(steps.max(initial=0.0)), interval, follows)]
    usual = float(np.quantile(steps, 0.95))
    leaps = np.flatnonzero(steps > max(_LEAP_STEPS * usual, _LEAP)) + 1
    bounds = [0, *leaps.tolist(), len(piece.t)]
    result = []
    for k, start in enumerate(bounds[:-1]):
        rows = slice(start, bounds[k + 1])
        result.append(_Stretch(piece.rows(rows), usual, interval, follows or k > 0))
    return result


def _moved_together(stretches: Sequence[_Stretch]) -> bool:
    """Return whether several robots jump at one time by one vector: the stage moved."""
    names = {stretch.name for stretch in stretches}
    leaps: dict[float, list[complex]] = {}
    for before, after in pairwise(stretches):
        if before.name == after.name and after.follows:
            vector = (after.track.position[0] - before.track.position[-1]) @ np.array([1, 1j])
            leaps.setdefault(float(after.track.t[0]), []).append(complex(vector))
    return len(names) > 1 and bool(leaps) and all(
        len(one) == len(names) and np.ptp(np.real(one)) + np.ptp(np.imag(one)) < 0.2 * abs(one[0])
        for one in leaps.values())


def _ended_there(stretches: Sequence[_Stretch], new: _Stretch) -> _Stretch | None:
    """Return the nearest stretch that ended just before a `new` one begins, near its start."""
    begin, place = new.track.t[0], new.track.position[0]
    best, least = None, np.inf
    for one in stretches:
        end = one.track.t[-1]
        if one is new or one.continued or one.follows or not (
                begin - _NEAR_FRAMES * new.interval <= end < begin):
            continue
        away = float(np.hypot(*(one.track.position[-1] - place)))
        if away < least and away <= max(_NEAR_STEPS * max(one.step, new.step), 1e-6):
            best, least = one, away
    return best
