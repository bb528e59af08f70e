"""Particles that a wall or the edge of the dish holds, from their response to commands there."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from microbot_ros.estimation.swimming import Swimming, response

FEWEST_FRAMES = 50
"""Fewest steps for a conclusion. Choice: two seconds of a usual camera."""

SURE = 4.0
"""Standard deviations by which the motion into a wall must fall short of the commands.

Choice: far beyond chance; a larger value finds walls later.
"""

NORMALS = np.exp(1j * np.pi * np.arange(90) / 90)
"""Directions in which, and against which, a wall is searched. Choice: 2° apart; more only cost
time."""

BORDER, INNER = 1.5, 0.92
"""Half-width of a border, in standard deviations of a step, and the quantile (`INNER`) of places
along its normal at its middle: beyond is only localisation error.

Choice: a wider border contains free particles, a narrower one loses held ones."""

LONG = 0.15
"""Smallest fraction of its steps that a held particle spends at the border.

Choice: a smaller value holds particles that only touched a wall.
"""

HELD, LEGS = 0.25, 4
"""Largest fraction of the path into a wall that a held particle moves, under at least this many
(`LEGS`) different commands.

Choice: a flow balances one command at most, and each at another place."""

SECONDS, SAMPLE, LOOK = 12.0, 0.1, 0.3
"""Span [s] of the recent past that is evaluated, and times between its samples (`SAMPLE`) and
between evaluations (`LOOK`).

Choice: a particle that left a wall is known again after 12 s; half the span has too few commands.
An evaluation takes 0.7 ms, as long as all else that the model does in a frame; at each sample it
would find walls no better.
"""

MEMORY = 40.0
"""Span [s] of the recent past from which it is known how a particle swims.

Choice: shorter ones hold too few directions, longer ones a speed of long ago.
"""

FIRST, AGAIN = (3.0, 6.0), (3.0, 1.5)
"""Spans [s], ending now, one of which must show a wall; and those (`AGAIN`) for a particle that is
held.

Choice: 3 s are a micrometre of diffusion, and 10 of motion; 6 s show slower particles, and 1.5 s
follow one that slides into a corner.
"""

CLEARLY = 10.0
"""Log-likelihood by which a wall must fit better than free motion.

Choice: at 6, headings that lag by 0.3 s are taken for walls now and then; a larger value finds
slow particles later.
"""

ANOTHER = np.deg2rad(20.0)
"""Difference of direction [rad] above which a command is another one.

Choice: at half of it noise of a controller counts as commands; at twice few controllers give four
of them into one wall.
"""


def is_held(z: np.ndarray, steps: np.ndarray, swum: np.ndarray, legs: np.ndarray) -> bool:
    """Return whether a wall holds a particle.

    A held particle is often at one straight border of all that it visits. There it moves along the
    border as commanded, but hardly towards it.

    Parameters
    ----------
    z : ndarray of complex, shape (T,)
        Positions before each step [m].
    steps : ndarray of complex, shape (T,)
        Steps [m].
    swum : ndarray of complex, shape (T,)
        Expected steps for v e^{iφ} = 1.
    legs : ndarray of int, shape (T,)
        Number of the command of each step.

    Returns
    -------
    bool
        False for fewer than FEWEST_FRAMES steps or LEGS commands.
    """
    if len(steps) < FEWEST_FRAMES or legs[-1] - legs[0] + 1 < LEGS or not swum.any():
        return False
    c = response(steps, swum)
    # The step after a reading that errs outwards goes inwards, so that the place is taken from the
    # reading before.
    z = np.append(z[:1], z[:-1])
    breadth = BORDER * float(np.sqrt(np.mean(np.abs(steps - c * swum) ** 2) / 2))
    out = np.ascontiguousarray((NORMALS.conj()[:, None] * z).real)
    outer = round((1 - INNER) * (len(z) - 1))
    ordered = np.partition(out, (outer, len(z) - 1 - outer), axis=1)
    low, high = ordered[:, outer, None], ordered[:, -1 - outer, None]
    inwards = np.concatenate([high - out, out - low])
    share = (np.abs(inwards) < breadth).mean(axis=1)
    k = int(share.argmax())
    if share[k] < LONG:
        return False
    normal = np.concatenate([NORMALS, -NORMALS])[k]
    there, free = np.abs(inwards[k]) < breadth, inwards[k] > 2 * breadth
    # A wall permits motion along it, and all motion elsewhere: c is fitted to these, as two real
    # numbers. Motion along the wall alone would determine c badly.
    along, way = (steps / (1j * normal)).real, swum / (1j * normal)
    moved, ways = np.append(along, (steps / normal).real[free]), np.append(way, 1j * way[free])
    columns = np.stack([ways.real, -ways.imag], axis=1)
    inverse = np.linalg.pinv(columns, rcond=1e-6)
    found = inverse @ moved
    towards = (complex(*found) * swum / normal).real
    if towards[there].sum() < 0:
        normal, towards = -normal, -towards
    pressed = there & (towards > 0)
    into = (swum[pressed] / normal).sum()
    weights = np.array([into.real, -into.imag]) @ inverse  # of what moved, in what is expected
    noise = float(np.std(along - columns[:len(along)] @ found))
    spread = noise * np.sqrt(pressed.sum() + weights @ weights)
    expected, gone = towards[pressed].sum(), (steps[pressed] / normal).real.sum()
    pushes = np.bincount(legs[pressed] - legs[0], towards[pressed])
    return bool(np.count_nonzero(pushes > 2 * breadth) >= LEGS and gone < HELD * expected
                and expected - gone > 2 * SURE * spread)


class HeldWatch:
    """Recent past of every particle, and which of them are held.

    Parameters
    ----------
    rolls : bool
        Whether particles are rollers. One that stands under one command may have stepped out, so
        it counts as held only by its response to several (`is_held`).

    Attributes
    ----------
    held : set of int
        Particles that a wall holds.
    """

    def __init__(self, rolls: bool = False) -> None:
        self._rolls = rolls
        self.held: set[int] = set()
        self._pasts: dict[int, _Past] = {}
        self._ways: dict[int, complex] = {}
        self._carried: dict[int, complex] = {}
        self._sampled = self._looked = -np.inf
        self._turn = 0
        self._to_look_at: set[int] = set()

    def add(self, t: float, ids: np.ndarray, z: np.ndarray, seen: np.ndarray,
            moved: dict[int, tuple[complex, complex]]) -> list[int]:
        """Add a frame.

        Parameters
        ----------
        t : float
            Time [s].
        ids : ndarray, shape (N,)
            Particles.
        z : ndarray of complex, shape (N,)
            Positions [m].
        seen : ndarray of bool, shape (N,)
            Which of them were seen.
        moved : dict of int to (complex, complex)
            For each particle of the frame before, the displacement since then for v e^{iφ} = 1,
            and by drift [m].

        Returns
        -------
        list of int
            Particles that are free again.
        """
        names = ids.tolist()
        nothing = 0j, 0j
        self._to_look_at |= set(names) - self._ways.keys()
        if t - self._looked >= LOOK:
            self._looked = t
            self._to_look_at = set(names)
        self._ways = {name: self._ways.get(name, 0j) + moved.get(name, nothing)[0]
                      for name in names}
        self._carried = {name: self._carried.get(name, 0j) + moved.get(name, nothing)[1]
                         for name in names}
        if t - self._sampled >= SAMPLE:
            self._sampled = t
            self._pasts = {name: self._pasts.get(name) or _Past() for name in names}
            for name, place, there in zip(names, z.tolist(), seen.tolist(), strict=True):
                if there:
                    self._pasts[name].track.append((t, place, self._ways[name],
                                                    self._carried[name]))
        before = self.held & set(names)
        self.held = set(before)
        if names:  # one per frame, since each takes most of a millisecond
            self._turn = (self._turn + 1) % len(names)
            if (name := names[self._turn]) in self._to_look_at:
                self._to_look_at.discard(name)
                self._look(name)
        return sorted(before - self.held)

    def _look(self, name: int) -> None:
        past = self._pasts.get(name) or _Past()
        t, z, way, carried = np.array(past.track, complex).reshape(-1, 4).T
        joined = np.diff(t.real) < 3 * SAMPLE
        steps, swum = np.diff(z - carried)[joined], np.diff(way)[joined]
        last = slice(-round(SECONDS / SAMPLE), None)
        held = is_held(z[:-1][joined][last], steps[last], swum[last],
                       _legs(np.angle(swum[last])))
        if not held or past.blocked:  # a speed that is learned from a held particle is wrong
            held |= not self._rolls and past.is_blocked(t[1:][joined].real, steps, swum)
        if name in self.held and not held:
            past.free_since = t[-1].real - FIRST[0]
        (self.held.add if held else self.held.discard)(name)


@dataclass
class _Past:
    """Recent past of a particle.

    Attributes
    ----------
    track : deque of (float, complex, complex, complex)
        Time [s], position [m], and the displacements since the first frame for v e^{iφ} = 1 and by
        drift [m].
    free_since : float
        Time [s] since when nothing holds it.
    swimming : Swimming, optional
        How it swam before it was blocked last.
    blocked : bool
        Whether something is in its way.
    """

    track: deque[tuple[float, complex, complex, complex]] = field(
        default_factory=lambda: deque(maxlen=round(MEMORY / SAMPLE)))
    free_since: float = -math.inf
    swimming: Swimming | None = None
    blocked: bool = False

    def is_blocked(self, t: np.ndarray, steps: np.ndarray, swum: np.ndarray) -> bool:
        """Return whether something is in its way, from its latest steps and those before.

        Parameters
        ----------
        t : ndarray, shape (T,)
            Time of each step [s].
        steps, swum : ndarray of complex, shape (T,)
            Steps [m], and the expected ones for v e^{iφ} = 1.

        Returns
        -------
        bool
            As before where the latest step has no command.
        """
        if not swum[-1:].any():  # where it swims without a command is not known
            return self.blocked
        t, steps, swum = t[swum != 0], steps[swum != 0], swum[swum != 0]
        if self.blocked and self.swimming:
            self.blocked = any(
                self.swimming.is_blocked(steps[-count:], swum[-count:], margin=0.0)
                for count in (round(seconds / SAMPLE) for seconds in AGAIN))
            return self.blocked
        first = int(np.searchsorted(t, self.free_since))
        for count in (round(seconds / SAMPLE) for seconds in FIRST):
            if len(t) - first < count:
                break
            known = Swimming.of(steps[first:-count], swum[first:-count]) or self.swimming
            if known and known.is_blocked(steps[-count:], swum[-count:], CLEARLY):
                self.blocked, self.swimming = True, known
        return self.blocked


def _legs(direction: np.ndarray) -> np.ndarray:
    """Return the number (T,) of the command of each step, by its `direction` (T,) [rad]."""
    legs, number = [], 0
    first = float(direction[0]) if len(direction) else 0.0
    for way in direction.tolist():
        if abs(math.remainder(way - first, math.tau)) > ANOTHER:
            first, number = way, number + 1
        legs.append(number)
    return np.array(legs, int)
