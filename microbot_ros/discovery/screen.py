"""What is wrong with sessions before anything is fitted, and what would be enough."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ros.discovery.evidence import Evidence, first_field
from microbot_ros.discovery.screen_remarks import remarks_on, stays
from microbot_ros.errors import InputError
from microbot_ros.records import Session

FEWEST_FRAMES = 50
FASTEST = 1e-3
"""Speed [m/s] beyond which positions can't be in micrometres: 200 radii of these spheres."""

FINEST = 5e-10
"""Steps [m] that no microscope resolves."""

SLOWEST_FRAMES, FASTEST_FRAMES = 10.0, 1e-4
"""Intervals between frames [s] beyond which times can't be in seconds."""

ALIKE = 20
"""Steps in a row that two recordings can't share by chance."""


def screen(sessions: Sequence[Session]) -> tuple[list[Evidence], tuple[str, ...]]:
    """The sessions as evidence, with remarks on what they can't tell.

    Raises InputError, with what would be enough, where nothing can be learnt.
    """
    if not sessions:
        raise InputError('', 'expected at least one session')
    _one_kind(sessions)
    whole = [_usable(session) for session in sessions]
    _all_different(whole)
    evidences = [e.without_jumps() for e in whole]
    remarks = [remark for e, cut in zip(whole, evidences, strict=True)
               for remark in remarks_on(e, cut.jumps)]
    remarks += _references(sessions)
    return [e.without_contact() for e in evidences], tuple(dict.fromkeys(remarks))


def _one_kind(sessions: Sequence[Session]) -> None:
    """Each commanded as its particles need, and all particles driven alike."""
    for session in sessions:
        kind = session.conditions.propulsion
        if kind == 'rolling' and session.commands.frequency is None and session.commands.t.size:
            raise InputError(session.name, 'propulsion is rolling: expected commands of '
                             'direction_rad,frequency_hz, found bx_mT,by_mT')
        if kind == 'catalytic' and session.commands.frequency is not None:
            raise InputError(session.name, 'propulsion is catalytic: expected commands of '
                             'bx_mT,by_mT, found direction_rad,frequency_hz of rolling particles')
        if kind != sessions[0].conditions.propulsion:
            raise InputError(session.name, 'expected sessions of one kind of propulsion, found '
                             f'{kind} beside {sessions[0].conditions.propulsion} in '
                             f'{sessions[0].name}: look at each kind by itself')


def _usable(session: Session) -> Evidence:
    name = session.name or 'session'
    if not np.isfinite(first_field(session.commands)):
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
    """Units and motion."""
    if not FASTEST_FRAMES <= e.interval <= SLOWEST_FRAMES:
        raise InputError(name, f'expected times in s, found frames every {e.interval:.3g} s: '
                         'milliseconds, frame numbers or hours?')
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
    usual = float(np.quantile(steps, 0.9))
    if usual < FINEST:
        raise InputError(name, f'expected positions in µm, found steps of {usual * 1e9:.2g} nm, '
                         'which no microscope resolves: metres or millimetres?')
    if stays(e).all():
        raise InputError(name, 'expected particles that move, found all within '
                         f'{usual * 1e6:.2g} µm of where they were: nothing but the error of '
                         'reading. Are they stuck? One that moves is enough')


def _all_different(evidences: list[Evidence]) -> None:
    known = [_runs(e) for e in evidences] if len(evidences) > 1 else []
    for k, runs in enumerate(known):
        for other in range(k):
            if len(runs & known[other]) > 0.2 * min(len(runs), len(known[other])) > 0:
                raise InputError(
                    evidences[k].name or 'session', 'expected different sessions, found the '
                    f'tracks of {evidences[other].name or "another"} again: the evidence would be '
                    'counted twice')


def _runs(e: Evidence) -> set[int]:
    """Hashes of stretches of steps, wherever they lie and whenever they were made."""
    steps = np.rint(np.diff(e.z, axis=0) * 1e13)
    steps[~(e.seen[1:] & e.seen[:-1])] = np.nan
    return {
        hash(run.tobytes()) for track in np.ascontiguousarray(steps.T)
        for run in np.lib.stride_tricks.sliding_window_view(track, min(ALIKE, len(track)))
        if np.isfinite(run).all()}


def _references(sessions: Sequence[Session]) -> list[str]:
    """Alignment times are stated at one field."""
    stated = [s.conditions.reference_field for s in sessions if s.conditions.reference_field]
    if len(set(stated)) < 2:
        return []
    return ['The sessions state different reference fields ('
            + ', '.join(f'{b * 1e3:g} mT' for b in dict.fromkeys(stated))
            + f'); alignment times are those at {stated[0] * 1e3:g} mT.']
