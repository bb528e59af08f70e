"""Checks of sessions before any fit, with messages that say what would be enough."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.estimation.held import FEWEST_FRAMES, is_held
from microbot_ros.estimation.identities import settle_identities
from microbot_ros.estimation.likelihood.prepared_session import (
    PreparedSession,
    first_field,
    prepare,
)
from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model

FASTEST = 1e-3
"""Speed [m/s] above which positions cannot be in µm: 200 radii of usual spheres in a second.

Choice: far above what a camera follows under a microscope.
"""

FINEST = 5e-10
"""Step [m] below which positions cannot be in µm: no microscope resolves it.

Choice: half a nanometre; a smaller value accepts positions in mm.
"""

SLOWEST_FRAMES, FASTEST_FRAMES = 10.0, 1e-4
"""Longest and shortest interval between frames [s] for times in seconds.

Choice: beyond the slowest time lapse, and beyond the fastest camera.
"""

BRIEFEST = 2.5
"""Shortest duration [s] of a recording while a field is commanded.

Measured: with nothing missing, 9 of 50 recordings of 1.7 and 2 s were given a false name, none of
100 of 2.7 to 10 s.
"""

ALIKE = 20
"""Consecutive steps that two recordings cannot share by chance.

Choice: at a resolution of 0.1 pm even a few are unique; more allow for tracks with gaps.
"""

STUCK = 1.5
"""Ratio of displacements over a quarter of the time to single steps below which a track stands
still.

Choice: 1 for localisation error alone; diffusion over a quarter of 100 frames makes it 5."""

FAINT = 2e-5
"""Field [T] below that of the Earth, 25 to 65 µT."""

SURE = 4.0
"""Standard deviations above which the speed of a particle along the commands is certain.

Choice: chance exceeds it in 1 of 3000 particles.
"""

def check_sessions(sessions: Sequence[Session],
                   ) -> tuple[list[PreparedSession], tuple[str, ...]]:
    """Prepare sessions for a fit, with remarks on what they do not determine.

    Parameters
    ----------
    sessions : sequence of Session
        Recordings of one rig.

    Returns
    -------
    prepared : list of PreparedSession
        Without particles that a wall holds.
    remarks : tuple of str
        Sentences for people.

    Raises
    ------
    InputError
        If nothing can be learnt; the message says what would be enough.
    """
    if not sessions:
        raise InputError('', 'expected at least one session')
    _one_kind(sessions)
    sessions, settled = zip(*map(settle_identities, sessions), strict=True)
    whole = [_usable(session) for session in sessions]
    _all_different(whole)
    walled = [at_a_wall(e) for e in whole]
    prepared = [prepare(_without(session, set(e.ids[held].tolist())))
                for session, e, held in zip(sessions, whole, walled, strict=True)]
    for e in prepared:
        if not e.joined().any():
            raise InputError(e.name, 'expected particles apart from each other: in every frame '
                             'they may touch within a step. Record more frames per second, or one '
                             'particle alone')
    remarks = [remark for session in sessions for remark in session.remarks]
    remarks += [remark for e, held, split, told in zip(
                    whole, walled, prepared, settled, strict=True)
                for remark in (*_left_out(e, held), *_remarks_on(e, int(split.jumps.sum())),
                               *(f'{e.name}: {one}' for one in told))]
    remarks += _references(sessions)
    return prepared, tuple(dict.fromkeys(remarks))


def _one_kind(sessions: Sequence[Session]) -> None:
    """Raise InputError unless commands fit the propulsion, which all sessions share."""
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
                                           f'{kind} beside {sessions[0].conditions.propulsion} '
                                           f'in {sessions[0].name}: analyse each kind '
                                           'separately')


def _usable(session: Session) -> PreparedSession:
    name = session.name or 'session'
    if not np.isfinite(first_field(session.commands)):
        raise InputError(name, 'expected commands with a nonzero field; found none. Without '
                               'them only drift and diffusion can be learned')
    commands = session.commands
    if session.conditions.propulsion == 'rolling' and not np.any(commands.frequency):
        raise InputError(name, 'expected commands with a rotating field; found a frequency of 0 '
                               'Hz throughout. Without rolling only drift and diffusion can be '
                               'learned')
    whole = PreparedSession.of(session)
    times = whole.times[whole.seen.any(axis=1)]
    if len(times) < FEWEST_FRAMES:
        raise InputError(name, f'expected at least {FEWEST_FRAMES} frames while a field is '
                         f'commanded, found {len(times)}; a minute at 30 frames/s is enough')
    _plausible(name, whole)
    if np.ptp(times) < BRIEFEST:
        raise InputError(name, f'expected at least {BRIEFEST:g} s while a field is commanded, '
                         f'found {np.ptp(times):.2g} s; a minute at 30 frames/s is enough')
    return whole


def _plausible(name: str, e: PreparedSession) -> None:
    """Raise InputError if units are wrong or nothing moves."""
    if not FASTEST_FRAMES <= e.interval <= SLOWEST_FRAMES:
        raise InputError(name, f'expected times in s, found frames every {e.interval:.3g} s: '
                               'are they in milliseconds, frame numbers or hours?')
    steps = np.abs(np.diff(e.z, axis=0))[e.joined()]
    if not steps.size:
        raise InputError(name, 'expected particles seen in consecutive frames, found none')
    speed = float(np.median(steps)) / e.interval
    if speed > FASTEST:
        raise InputError(name, f'expected positions in µm, found steps of {speed * 1e3:.3g} mm/s: '
                               'are they in pixels or nanometres?')
    if not steps.any():
        raise InputError(name, 'expected particles that move, found the same positions in all '
                         'frames')
    usual = float(np.quantile(steps, 0.9))
    if usual < FINEST:
        raise InputError(name, f'expected positions in µm, found steps of {usual * 1e9:.2g} nm, '
                         'which no microscope resolves: metres or millimetres?')
    if _stays(e).all():
        raise InputError(name, f'expected particles that move, found all within {usual * 1e6:.2g} '
                               'µm of their place: only measurement error. Are they stuck? One '
                               'that moves is enough')


def _all_different(sessions: list[PreparedSession]) -> None:
    known = [_runs(e) for e in sessions] if len(sessions) > 1 else []
    for k, runs in enumerate(known):
        for other in range(k):
            if len(runs & known[other]) > 0.2 * min(len(runs), len(known[other])) > 0:
                raise InputError(
                    sessions[k].name or 'session', 'expected different sessions, found the '
                                                   'tracks of '
                                                   f'{sessions[other].name or "another"} '
                                                   'again: the data would be counted twice')


def _runs(e: PreparedSession) -> set[int]:
    """Return hashes of runs of steps, independent of their place and time."""
    steps = np.rint(np.diff(e.z, axis=0) * 1e13)
    steps[~e.joined()] = np.nan
    return {
        hash(run.tobytes()) for track in np.ascontiguousarray(steps.T)
        for run in np.lib.stride_tricks.sliding_window_view(track, min(ALIKE, len(track)))
        if np.isfinite(run).all()}


def _references(sessions: Sequence[Session]) -> list[str]:
    """Return a remark if sessions state different reference fields of alignment times."""
    stated = [s.conditions.reference_field for s in sessions if s.conditions.reference_field]
    if len(set(stated)) < 2:
        return []
    return ['The sessions state different reference fields ('
            + ', '.join(f'{b * 1e3:g} mT' for b in dict.fromkeys(stated))
            + f'); alignment times are those at {stated[0] * 1e3:g} mT.']


def _remarks_on(e: PreparedSession, jumps: int) -> Iterator[str]:
    """Yield remarks on a session `e` of whole tracks, `jumps` of whose steps were cut."""
    commands = e.commands
    field = commands.field[commands.index_at(e.times)]
    if np.abs(np.exp(1j * np.arctan2(field[:, 1], field[:, 0])).mean()) > 1 - 1e-6:
        clock = ('' if (commands.t > e.times[0]).any() else
                 ' (No command changes between the first and the last frame: are both on one '
                 'clock?)')
        yield (f'{e.name}: the command never turned. v and φ absorb drift, background field, '
               f'coils and camera; record steps in all directions.{clock}')
    strongest = float(np.hypot(*field.T).max())
    if commands.frequency is None and strongest < FAINT:
        yield (f"{e.name}: no field exceeds {strongest * 1e3:.2g} mT, less than the Earth's "
               'field: are the commands in mT?')
    if jumps:
        yield (f'{e.name}: {jumps} step{" is" if jumps == 1 else "s are"} longer than the motion '
               'before and after; tracks were cut there. Did the tracker slip, did the stage '
               'move?')
    if len(np.unique(e.ids)) == 1:
        yield (f'{e.name}: one particle. Effects between particles cannot be seen, and an effect '
               'on all particles cannot be distinguished from one on a single particle; record '
               'three or more.')
    yield from _idle(e)


def _idle(e: PreparedSession) -> Iterator[str]:
    """Yield remarks on particles that stay where they are, or that no command moves."""
    stuck = e.ids[_stays(e)]
    if stuck.size:
        names = ', '.join(map(str, stuck))
        yield (f'{e.name}: stuck, as the position does not change: particle {names}. It '
               'contradicts any effect that moves the others; leave it out.')
    if not _follows(e).any():
        yield (f'{e.name}: no particle follows the commands. Effects on their propulsion cannot '
               'be seen. Were the coils on, is there fuel, do commands and tracks share one '
               'clock?')


def at_a_wall(e: PreparedSession) -> np.ndarray:
    """Return which tracks are held by a wall, or the edge of the dish, for much of the time.

    Such tracks are often at one straight border of all that they visit. There they move along it
    as commanded, but hardly towards it.

    Parameters
    ----------
    e : PreparedSession
        Session of N tracks.

    Returns
    -------
    ndarray of bool, shape (N,)
        True for tracks that are held.
    """
    swum = respond(Model.baseline(e.conditions, e.commands), e.timeline).propulsion
    swum = np.broadcast_to(swum, (len(e.times) - 1, len(e.ids)))
    use = e.joined()
    legs = e.commands.index_at(e.times[:-1])
    return np.array([
        is_held(e.z[:-1, n][used], np.diff(e.z[:, n])[used], swum[used, n], legs[used])
        for n, used in enumerate(use.T)], bool)


def _without(session: Session, names: set[int]) -> Session:
    if not names:
        return session
    tracks = session.tracks
    kept = tracks.of(np.setdiff1d(tracks.particle, list(names)))
    if not len(kept.t):
        raise InputError(session.name or 'session', 'expected particles in free fluid, found '
                                                    'all pressed against a wall or the edge '
                                                    'of the dish. One that moves freely is '
                                                    'enough')
    return replace(session, tracks=kept)


def _left_out(e: PreparedSession, held: np.ndarray) -> list[str]:
    names = ', '.join(map(str, e.ids[held]))
    return [f'{e.name}: pressed against a wall or the edge of the dish: particle {names}. Left '
            'out: the force that holds it acts on no other particle.'] if names else []


def _stays(e: PreparedSession) -> np.ndarray:
    """Return which tracks (N,) move no further in a quarter of the time than between frames.

    A particle that feedback holds in place does so too, but follows the commands.
    """
    z = np.where(e.seen, e.z, np.nan)
    quarter = len(z) // 4
    with np.errstate(invalid='ignore'):
        far, near = (
            np.array([np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else np.nan
                      for x in np.abs(z[lag:] - z[:-lag]).T])
            for lag in (quarter, 1))
        still = far <= STUCK * near
    result: np.ndarray = still & ~_follows(e)
    return result


def _follows(e: PreparedSession) -> np.ndarray:
    """Return which tracks (N,) have a certain speed, by regression on the first-order model."""
    model = Model.baseline(e.conditions, e.commands)
    swum = respond(model, e.timeline).propulsion
    use = e.joined()
    moved, swum = np.where(use, np.diff(e.z, axis=0), 0), np.where(use, swum, 0)
    power = np.maximum((np.abs(swum) ** 2).sum(axis=0), 1e-300)
    speed = (np.conj(swum) * moved).sum(axis=0) / power
    left = np.abs(np.where(use, moved - speed * swum, 0)) ** 2
    variance = left.sum(axis=0) / np.maximum(2 * use.sum(axis=0) - 2, 1) / power
    result: np.ndarray = np.abs(speed) ** 2 > SURE**2 * variance
    return result
