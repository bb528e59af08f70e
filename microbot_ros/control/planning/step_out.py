"""What makes rollers different to one field: whether they follow a single turn of it.

A moment that a field drags round at the frequency f lags by δ, dδ/dt = 2π(f − f_c sin δ), with the
step-out f_c in proportion to the field (Adler, Proceedings of the IRE 34, 351 (1946); for magnetic
rotors McNaughton et al., International Journal of Nanomedicine 4, 285 (2009); for telling devices
apart by it Mahoney, Nelson, Peyer, Nelson and Abbott, Applied Physics Letters 104, 144101 (2014)).
Beyond f_c it slips, and where in its slip it is when the field turns elsewhere is chance.

A leg here is one whole turn, after which the field stands. Who has kept up by then to within
half a turn makes the turn, to the end; who has not falls back to where it was. So a roller goes as
far as in one turn or not at all, whatever went before. Turns that are faster and faster, or in
weaker and weaker fields, tell one roller after the other apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from microbot_ros.control.contract import NoSolutionError

THRESHOLD = 0.67645
"""f_c/f of a roller that lags by half a turn after one: (π + 2 arcsin r)/√(1 − r²) = 2π."""
STEP = 1.03
"""Ratio of the step-outs from which on rollers follow neighbouring kinds of turns."""
LEAST_TURN = 0.3e-6
"""What a roller goes per turn at least [m]."""
_ALL_FOLLOW = 6
"""Kinds, the slowest, that every roller follows."""
_SETTLES = 0.4
"""Time that a leg needs to come to rest, times the step-out of who only just follows."""
_CLEAR = 0.3
"""Of a turn: kinds of which all rollers make one or none, to within that, are clear."""
_UNCLEAR = 0.1
"""How gladly other kinds are used."""
_FAITH = 0.3
"""What part of the difference to what was seen is taken over at once."""
_DEAR = 4.0
"""How much longer a detour may be per length of room that it gives where it lacks."""
_WEIGHED = 12
"""Turns that are weighed by their room, at each step."""
_ROUNDS = 12
_WORTH = 0.15
"""Of a turn: legs that are less are left for the next time."""


@dataclass(frozen=True)
class Leg:
    """One turn of a `kind` (an index of `SingleTurns`) along `way`, a unit complex number."""

    kind: int
    way: complex


class SingleTurns:
    """The kinds of legs (M): each a frequency and a share of the field.

    Rollers follow those kinds up to their step-out: it rises from kind to kind. `answer` (N, M)
    [m] is what each of N rollers makes of a turn along x: c = g e^{iφ} or nothing. A survey tells.
    """

    def __init__(self, slowest: float, fastest: float, tick: float, delay: int) -> None:
        """From a turn that rollers with a step-out of `slowest` [Hz] just follow to one for
        `fastest` [Hz], which no leg exceeds.

        A leg takes whole `ticks` of `tick` [s], and `rest` after that: so many as `delay`, and
        until those who lag have fallen back or come up. Where a step-out asks for a little less
        than whole ticks the field is made weaker.
        """
        edge = slowest * STEP ** np.arange(
            1 + math.floor(math.log(fastest / slowest) / math.log(STEP)))
        least = max(math.ceil(1 / (fastest * tick) - 1e-9), 1)
        self.ticks = np.maximum(np.ceil(THRESHOLD / (edge * tick) - 1e-9).astype(int), least)
        self.frequency = 1 / (self.ticks * tick)
        self.share = self.frequency * THRESHOLD / edge
        self.rest = delay + np.ceil(_SETTLES / (edge * tick)).astype(int)
        self.seconds = (self.ticks + self.rest) * tick
        self.answer = np.zeros((0, len(edge)), complex)

    def survey(self) -> list[Leg]:
        """Each kind out or back along x, then along y: all end about where they began."""
        return [Leg(kind, way * (-1) ** kind) for way in (1 + 0j, 1j)
                for kind in range(len(self.ticks))]

    def see(self, moved: np.ndarray) -> None:
        """In the legs of the survey all have `moved` (L, N) [m].

        NoSolutionError for rollers that do not roll, or that one field can't tell apart.
        """
        ways = np.array([leg.way for leg in self.survey()])
        made = (moved / ways[:, None]).reshape(2, len(self.ticks), -1).mean(0).T
        slow = made[:, :_ALL_FOLLOW].mean(1)
        if not (np.abs(slow) > LEAST_TURN).all():
            raise NoSolutionError(f'number {np.argmin(np.abs(slow))} of the particles does not '
                                  'roll')
        part = (made / slow[:, None]).real
        follows = part > 0.5
        clear = (np.abs(part - follows) < _CLEAR).all(0)
        same = (follows[:, None] == follows).all(-1) & ~np.eye(len(follows), dtype=bool)
        if same.any():
            a, b = np.argwhere(same)[0]
            raise NoSolutionError(f'numbers {a} and {b} of the particles step out at so much the '
                                  'same frequency that no field tells them apart')
        gain = (made * follows).sum(1) / follows.sum(1)
        self.answer = np.where(clear, np.where(follows, gain[:, None], 0j), made)
        self._gladly = np.where(clear, 1.0, _UNCLEAR)

    def turns(self, displacement: np.ndarray) -> np.ndarray:
        """How many turns of each kind, and which way (M,), displace each by `displacement` (N,)
        [m]: Σ answer_im U_m, in the least time Σ seconds_m |U_m|.

        By reweighted least squares (Chartrand and Yin, ICASSP 2008, 3869).
        """
        weight = self._gladly
        some = 1e-6 * float(np.abs(self.answer).max()) ** 2
        turns = np.zeros(len(self.seconds), complex)
        for _ in range(_ROUNDS):
            back = weight[:, None] * self.answer.conj().T
            turns = back @ np.linalg.solve(
                self.answer @ back + some * np.eye(len(displacement)), displacement)
            weight = self._gladly * (np.abs(turns) + 1e-3) / self.seconds
        return turns

    def time(self, displacement: np.ndarray) -> float:
        """How long [s] it takes to displace each by `displacement` (N,) [m], about."""
        return float(self.seconds @ np.abs(self.turns(displacement)))

    def legs(self, displacement: np.ndarray,
             slack: Callable[[np.ndarray], np.ndarray] | None = None) -> list[Leg]:
        """Whole turns that add up to `displacement` (N,) [m], one after the other.

        Each time that which leaves the smallest detour of any roller from a straight way; a
        detour that gives room where it lacks may be longer. `slack` tells how much [m] (C,) is to
        spare, less than 0 where it lacks, where all have moved by each of (N, C) [m].
        """
        left = [leg for kind, u in enumerate(self.turns(displacement).tolist())
                for leg in _whole(kind, u)]
        moves = self.moves(left)
        at, order = np.zeros(len(displacement), complex), []
        rest = list(range(len(left)))
        for done in range(1, len(left) + 1):
            due = displacement * (done / len(left))
            moved = at[:, None] + moves[:, rest]
            detour = np.abs(moved - due[:, None]).max(0)
            nearest = np.argsort(detour)[:1 if slack is None else _WEIGHED]
            if slack is not None:
                room = np.minimum(slack(moved[:, nearest]), 0)
                nearest = nearest[np.argsort(detour[nearest] - _DEAR * room)]
            order.append(rest.pop(int(nearest[0])))
            at = at + moves[:, order[-1]]
        return [left[k] for k in order]

    def moves(self, legs: list[Leg]) -> np.ndarray:
        """What `legs` (L) do to each (N, L) [m]."""
        way = np.array([leg.way for leg in legs], complex)
        return np.asarray(self.answer[:, [leg.kind for leg in legs]] * way)

    def learn(self, leg: Leg, moved: np.ndarray) -> None:
        """After a `leg` all have `moved` (N,) [m]."""
        off = moved / leg.way - self.answer[:, leg.kind]
        self.answer[:, leg.kind] += _FAITH * off


def _whole(kind: int, u: complex) -> Iterator[Leg]:
    """Unit steps that add up to u: along it, and two that lean as far as makes up the rest."""
    size = abs(u)
    if size < _WORTH:
        return
    way = u / size
    if abs(size - round(size)) < _WORTH:
        yield from [Leg(kind, way)] * round(size)
        return
    along = max(math.ceil(size) - 2, 0)
    lean = math.acos((size - along) / 2)
    yield from [Leg(kind, way)] * along
    for side in (lean, -lean):
        yield Leg(kind, way * complex(math.cos(side), math.sin(side)))
