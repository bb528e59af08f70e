"""What a session can't tell, or seems to have wrong, though something can be learnt from it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from microbot_ros.discovery.evidence import JUMP, Evidence
from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model

STUCK = 1.5
"""Steps over a quarter of the time are this much longer than single ones if anything moves."""

FAINT = 2e-5
"""Fields [T] below the Earth's."""

SURE = 4.0
"""Standard deviations from which a particle is said to follow the commands."""


def remarks_on(e: Evidence, jumps: int) -> Iterator[str]:
    """Remarks on a whole session in which so many steps are longer than any motion."""
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
        yield (f'{e.name}: no field exceeds {strongest * 1e3:.2g} mT, less than the Earth’s: are '
               'the commands in mT?')
    if jumps:
        yield (f'{e.name}: {jumps} step{" is" if jumps == 1 else "s are"} longer than any '
               'motion; tracks were cut there. Did the stage move, were particles confused?')
    yield from _switches(e)
    if len(np.unique(e.ids)) == 1:
        yield (f'{e.name}: one particle. What acts between particles can’t be seen, and what acts '
               'on all can’t be told from what acts on one; record three or more.')
    yield from _idle(e)


def _switches(e: Evidence) -> Iterator[str]:
    """Pairs of which each jumps to where the other was."""
    z = np.where(e.seen, e.z, np.nan)
    steps = np.abs(np.diff(z, axis=0))
    usual = float(np.nanquantile(steps, 0.99))
    for k, i in zip(*np.nonzero(np.nan_to_num(steps) > JUMP * usual), strict=True):
        crossed = (np.abs(z[k + 1, i] - z[k]) <= usual) & (np.abs(z[k + 1] - z[k, i]) <= usual)
        for j in crossed.nonzero()[0]:
            if i < j:
                yield (f'{e.name}: particles {e.ids[i]} and {e.ids[j]} exchange places at '
                       f'{e.times[k + 1]:.2f} s: their tracks are swapped. Exchange their names '
                       'from there on, or leave out what follows.')


def _idle(e: Evidence) -> Iterator[str]:
    """Particles that stay where they are, or that no command moves."""
    stuck = e.ids[stays(e)]
    if stuck.size:
        names = ', '.join(map(str, stuck))
        yield (f'{e.name}: stuck, since it goes nowhere: particle {names}. It denies what carries '
               'the others; better left out.')
    if not _follows(e).any():
        yield (f'{e.name}: no particle follows the commands. What acts on their swimming can’t be '
               'seen. Were the coils on, is there fuel, are commands and tracks on one clock?')


def stays(e: Evidence) -> np.ndarray:
    """Tracks (N,) bool that go no further in a quarter of the time than from frame to frame.

    A particle that feedback holds in place does the same, but follows the commands.
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


def _follows(e: Evidence) -> np.ndarray:
    """Tracks (N,) bool with a speed, by regression on the first-order model, beyond doubt."""
    model = Model.baseline(e.conditions, e.commands)
    swum = respond(model, e.timeline).propulsion
    use = e.seen[1:] & e.seen[:-1]
    moved, swum = np.where(use, np.diff(e.z, axis=0), 0), np.where(use, swum, 0)
    power = np.maximum((np.abs(swum) ** 2).sum(axis=0), 1e-300)
    speed = (np.conj(swum) * moved).sum(axis=0) / power
    left = np.abs(np.where(use, moved - speed * swum, 0)) ** 2
    variance = left.sum(axis=0) / np.maximum(2 * use.sum(axis=0) - 2, 1) / power
    result: np.ndarray = np.abs(speed) ** 2 > SURE**2 * variance
    return result
