"""What is wrong with sessions before anything is fitted, and what would be enough."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ros.discovery.evidence import Evidence, first_field
from microbot_ros.errors import InputError
from microbot_ros.records import Session

FEWEST_FRAMES = 50
FASTEST = 1e-3
"""Speed [m/s] beyond which positions can't be in micrometres: 200 radii of these spheres."""


def screen(sessions: Sequence[Session]) -> tuple[list[Evidence], tuple[str, ...]]:
    """The sessions as evidence, with remarks on what they can't tell.

    Raises InputError, with what would be enough, where nothing can be learnt.
    """
    if not sessions:
        raise InputError('', 'expected at least one session')
    evidences = [_usable(session).without_jumps() for session in sessions]
    _all_different(evidences)
    remarks = [remark for e in evidences for remark in _remarks(e)]
    if len({session.conditions.propulsion for session in sessions}) > 1:
        raise InputError(sessions[1].name, 'expected sessions of one kind of propulsion')
    return [e.without_contact() for e in evidences], tuple(dict.fromkeys(remarks))


def _usable(session: Session) -> Evidence:
    name = session.name or 'session'
    start = first_field(session.commands)
    if not np.isfinite(start):
        raise InputError(name, 'expected commands with a field that is not zero; found none, and '
                         'without them only drift and diffusion could be learnt')
    evidence = Evidence.of(session)
    frames = int((evidence.seen.sum(axis=1) > 0).sum())
    if frames < FEWEST_FRAMES:
        raise InputError(name, f'expected at least {FEWEST_FRAMES} frames while a field is '
                         f'commanded, found {frames}; a minute at 30 frames/s is enough')
    _plausible(name, evidence)
    return evidence


def _plausible(name: str, e: Evidence) -> None:
    steps = np.abs(np.diff(e.z, axis=0))[e.seen[1:] & e.seen[:-1]]
    if not steps.size:
        raise InputError(name, 'expected particles seen in consecutive frames, found none')
    speed = float(np.median(steps)) / e.interval
    if speed > FASTEST:
        raise InputError(name, f'expected positions in µm, found steps of {speed * 1e3:.3g} mm/s: '
                         'pixels or nanometres?')
    if not steps.any():
        raise InputError(name, 'expected particles that move, found the same positions in all '
                         'frames')


def _all_different(evidences: list[Evidence]) -> None:
    for k, e in enumerate(evidences):
        for other in evidences[:k]:
            if e.z.shape == other.z.shape and np.array_equal(e.z, other.z):
                raise InputError(e.name or 'session', 'expected different sessions, found the '
                                 f'tracks of {other.name or "another"} again: the evidence would '
                                 'be counted twice')


def _remarks(e: Evidence) -> list[str]:
    said = []
    commands = e.commands
    later = commands.field[commands.index_at(e.times)]
    angle = np.arctan2(later[:, 1], later[:, 0])
    if np.abs(np.exp(1j * angle).mean()) > 1 - 1e-6:
        said.append(
            f'{e.name}: the command never turned. v and φ absorb drift, background field, coils '
            'and camera; record steps in all directions.')
    if e.jumps:
        said.append(
            f'{e.name}: {e.jumps} steps are longer than any motion; tracks were cut there. Did '
            'the stage move, were particles confused?')
    if len(np.unique(e.ids)) == 1:
        said.append(
            f'{e.name}: one particle. What acts between particles can’t be seen, and what acts '
            'on all can’t be told from what acts on one; record three or more.')
    return said
