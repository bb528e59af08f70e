"""Which robot a stretch of a sheet is: sheets of trackers change their robots on the way.

A tracker that keeps its robots in a list writes one sheet per place in the list. When a robot is
deleted, those behind it move up, and their sheets leap to another robot between two rows. A robot
that was lost may be picked up again elsewhere, or another one in its stead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from microbot_ros.common.records import Tracks
from microbot_ros.session.spreadsheets.sheets import Assumptions

_LEAP_STEPS = 6.0
_LEAP = 10e-6
"""A step longer than both is a leap: in steps that 95 of 100 stay below, and in metres. The
longest step of robots that roll at 20 Hz, over a skipped frame, is 3 of the former."""
_NEAR_STEPS = 4.0
"""A stretch goes on where another ended if it begins within as many of such steps."""
_NEAR_FRAMES = 5.0
_FEWEST = 20
"""Rows from which the usual step of a sheet is known."""


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
    """Tracks whose `pieces` bear the identity of the robot that they show.

    A piece is a stretch of one sheet; several of the same name were cut from one another. Pieces
    of several robots are returned as they are. After a leap or a cut a stretch has the identity
    of the robot that was last seen where it begins, else a new one. `said` notes each change.
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
                           + (': it is where that one was' if there else ', elsewhere'))
    for change in changes:
        said.add(change)
    return [*mixed, *(stretch.track for stretch in stretches)]


def _split(piece: Tracks, follows: bool) -> list[_Stretch]:
    """The stretches of a `piece` between leaps."""
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
        track = Tracks(*(getattr(piece, name)[rows] for name in (
            't', 'particle', 'position', 'theta', 'sigma')))
        result.append(_Stretch(track, usual, interval, follows or k > 0))
    return result


def _moved_together(stretches: Sequence[_Stretch]) -> bool:
    """Whether several robots leap at one time by one vector: the stage moved, not the robots."""
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
    """The nearest stretch that ended just before a `new` one begins, near that place."""
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
