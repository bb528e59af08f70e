"""What makes rollers different to one field: whether they follow a single turn of it.

A moment that a field drags round at the frequency f lags by δ, dδ/dt = 2π(f − f_c sin δ), with the
step-out f_c in proportion to the field (Adler, Proceedings of the IRE 34, 351 (1946); for magnetic
rotors McNaughton et al., International Journal of Nanomedicine 4, 285 (2009); for telling devices
apart by it Mahoney, Nelson, Peyer, Nelson and Abbott, Applied Physics Letters 104, 144101 (2014)).
Beyond f_c it slips, and where in its slip it is when the field turns elsewhere is chance.

So a leg here is one whole turn, after which the field stands. Who has kept up by then to within
half a turn makes the turn, to the end; who has not falls back to where it was. A roller that goes
g per turn so goes g or nothing, whatever its phase was: what is left to chance, and every error
of f_c that does not take a roller across the threshold, is gone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

THRESHOLD = 0.6757
"""f_c/f of a roller that lags by half a turn after one: (π + 2 arcsin r)/√(1 − r²) = 2π."""
LOCKED = 0.8
"""f/f_c at which a roller surely follows."""
ALIKE = 1.05
"""Ratio of two step-outs below which no threshold fits in between."""
FAITH = 0.5
"""What part of the difference to what was seen is taken over at once."""
_ROUNDS = 12
_WORTH = 0.15
"""Of a turn: legs that are less are left for the next time."""


@dataclass(frozen=True)
class Leg:
    """One turn of a `kind` (an index of `SingleTurns`) along `way`, a unit complex number."""

    kind: int
    way: complex


class SingleTurns:
    """The kinds of legs (M) for rollers (N): each a frequency and a share of the field.

    Two thresholds lie between neighbouring step-outs, and one below all. `answer` (N, M) [m] is
    what each makes of a turn along x: c = g e^{iφ} or nothing, until it has been seen.
    """

    def __init__(self, gain: np.ndarray, step_out: np.ndarray, fastest: float, tick: float,
                 pause: int) -> None:
        """For `gain` c (N,) [m per turn] and `step_out` (N,) [Hz] at the full field.

        A leg takes whole ticks of `tick` [s], not fewer than `fastest` [Hz] allows, and `pause`
        ticks after it. Where a threshold would ask for more than that, the field is made weaker.
        """
        edge = _thresholds(np.sort(step_out))
        least = max(math.ceil(1 / (fastest * tick) - 1e-9), 1)
        self.ticks = np.maximum(np.ceil(THRESHOLD / (edge * tick) - 1e-9).astype(int), least)
        self.frequency = 1 / (self.ticks * tick)
        self.share = self.frequency * THRESHOLD / edge
        self.seconds = (self.ticks + pause) * tick
        self.answer = np.where(step_out[:, None] > edge, gain[:, None], 0j)

    def turns(self, displacement: np.ndarray) -> np.ndarray:
        """How many turns of each kind, and which way (M,), displace each by `displacement` (N,)
        [m]: Σ answer_im U_m, in the least time Σ seconds_m |U_m|.

        By reweighted least squares (Chartrand and Yin, ICASSP 2008, 3869).
        """
        weight = np.ones(len(self.seconds))
        some = 1e-6 * float(np.abs(self.answer).max()) ** 2
        turns = np.zeros(len(weight), complex)
        for _ in range(_ROUNDS):
            back = weight[:, None] * self.answer.conj().T
            turns = back @ np.linalg.solve(
                self.answer @ back + some * np.eye(len(displacement)), displacement)
            weight = (np.abs(turns) + 1e-3) / self.seconds
        return turns

    def time(self, displacement: np.ndarray) -> float:
        """How long [s] it takes to displace each by `displacement` (N,) [m], about."""
        return float(self.seconds @ np.abs(self.turns(displacement)))

    def legs(self, displacement: np.ndarray) -> list[Leg]:
        """Whole turns that add up to `displacement` (N,) [m], one after the other.

        Each time that which leaves the smallest detour of any roller from a straight way.
        """
        left = [leg for kind, u in enumerate(self.turns(displacement).tolist())
                for leg in _whole(kind, u)]
        moves = self.moves(left)
        at, order = np.zeros(len(displacement), complex), []
        rest = list(range(len(left)))
        for done in range(1, len(left) + 1):
            due = displacement * (done / len(left))
            detour = np.abs((at - due)[:, None] + moves[:, rest]).max(0)
            order.append(rest.pop(int(np.argmin(detour))))
            at = at + moves[:, order[-1]]
        return [left[k] for k in order]

    def moves(self, legs: list[Leg]) -> np.ndarray:
        """What `legs` (L) do to each (N, L) [m]."""
        way = np.array([leg.way for leg in legs], complex)
        return np.asarray(self.answer[:, [leg.kind for leg in legs]] * way)

    def learn(self, leg: Leg, moved: np.ndarray) -> None:
        """After a `leg` all have `moved` (N,) [m]."""
        off = moved / leg.way - self.answer[:, leg.kind]
        self.answer[:, leg.kind] += FAITH * off


def _thresholds(step_out: np.ndarray) -> np.ndarray:
    """Step-outs (M,) [Hz] from which on rollers follow: below all, and two in each gap."""
    low, high = step_out[:-1], step_out[1:]
    apart = high > ALIKE * low
    low, high = low[apart], high[apart]
    lowest = step_out[:1] * THRESHOLD * LOCKED
    return np.concatenate([lowest, low ** (2 / 3) * high ** (1 / 3),
                           low ** (1 / 3) * high ** (2 / 3)])


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
