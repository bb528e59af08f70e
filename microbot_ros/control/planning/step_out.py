"""Rollers differ under one field by whether they follow a single rotation of it.

A moment dragged by a field that rotates at the frequency f lags by δ, dδ/dt = 2π(f − f_c sin δ),
with the step-out f_c proportional to the field (Adler, Proceedings of the IRE 34, 351 (1946); for
magnetic rotors McNaughton et al., International Journal of Nanomedicine 4, 285 (2009); to address
single devices Mahoney, Nelson, Peyer, Nelson and Abbott, Applied Physics Letters 104, 144101
(2014)). Beyond f_c it slips, and its phase at the next change of the field is random.

A leg here is one full rotation, after which the field stands still. A roller that lags by less
than half a turn then completes the turn; any other falls back to where it was. So a roller moves
by one full turn or not at all, whatever happened before. Ever faster rotations, or rotations in
ever weaker fields, separate one roller after the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from microbot_ros.control.contract import NoSolutionError

THRESHOLD = 0.67645
"""f_c/f of a roller that lags half a turn after one: (π + 2 arcsin r)/√(1 − r²) = 2π."""
STEP = 1.03
"""Choice: ratio of the step-outs of neighbouring kinds of turns."""
LEAST_TURN = 0.3e-6
"""Choice: least displacement per turn [m] of something that rolls."""
_ALL_FOLLOW = 6
"""Choice: number of the slowest kinds, which every roller follows."""
_SETTLES = 0.4
"""Choice: settling time of a leg times the step-out of a roller that only just follows."""
_CLEAR = 0.3
"""Choice: deviation from one turn or none, in turns, up to which a kind is unambiguous."""
_UNCLEAR = 0.1
"""Choice: weight of ambiguous kinds."""
_FAITH = 0.3
"""Choice: part of the difference to a measured leg that is adopted at once."""
_DEAR = 4.0
"""Choice: how much longer a detour may be per length of clearance gained where it lacks."""
_WEIGHED = 12
"""Choice: turns compared by their clearance at each step."""
_ROUNDS = 12  # choice: iterations of the reweighted least squares
_WORTH = 0.15
"""Choice: legs of less than this part of a turn are postponed."""


@dataclass(frozen=True)
class Leg:
    """One turn of a `kind` (index of `SingleTurns`) along `way`, a unit complex number."""

    kind: int
    way: complex


class SingleTurns:
    """The M kinds of legs, each with a frequency and a share of the field.

    Rollers follow the kinds up to their step-out, which rises from kind to kind. `answer` (N, M)
    [m] is the displacement of each of N rollers by a turn along x, c = g e^{iφ} or 0; a survey
    measures it.

    Parameters
    ----------
    slowest : float
        Lowest step-out [Hz].
    fastest : float
        Highest step-out, and highest frequency of a leg [Hz].
    tick : float
        Length of a tick [s].
    delay : int
        Delay of a command, in ticks.
    """

    def __init__(self, slowest: float, fastest: float, tick: float, delay: int) -> None:
        """Make kinds from step-outs `slowest` to `fastest` [Hz]; no leg exceeds the latter.

        A leg takes whole `ticks` of `tick` [s], followed by `rest`: `delay` ticks plus the time in
        which lagging rollers fall back or catch up. A field slightly weaker replaces fractions of
        a tick.
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
        """Return legs of each kind, alternating along ±x, then ±y: all end near their start.

        Returns
        -------
        list of Leg
            The legs.
        """
        return [Leg(kind, way * (-1) ** kind) for way in (1 + 0j, 1j)
                for kind in range(len(self.ticks))]

    def see(self, moved: np.ndarray) -> None:
        """Learn the responses from displacements `moved` (L, N) [m] in the legs of the survey.

        Raises NoSolutionError for particles that do not roll or that one field cannot separate.

        Parameters
        ----------
        moved : ndarray, shape (L, N)
            Displacements, complex [m].
        """
        ways = np.array([leg.way for leg in self.survey()])
        made = (moved / ways[:, None]).reshape(2, len(self.ticks), -1).mean(0).T
        slow = made[:, :_ALL_FOLLOW].mean(1)
        if not (np.abs(slow) > LEAST_TURN).all():
            raise NoSolutionError(f'particle number {np.argmin(np.abs(slow))} has no rolling '
                                  'speed in the model')
        part = (made / slow[:, None]).real
        follows = part > 0.5
        clear = (np.abs(part - follows) < _CLEAR).all(0)
        same = (follows[:, None] == follows).all(-1) & ~np.eye(len(follows), dtype=bool)
        if same.any():
            a, b = np.argwhere(same)[0]
            raise NoSolutionError(f'particles number {a} and {b} have step-out frequencies too '
                                  'similar to be driven apart')
        gain = (made * follows).sum(1) / follows.sum(1)
        self.answer = np.where(clear, np.where(follows, gain[:, None], 0j), made)
        self._gladly = np.where(clear, 1.0, _UNCLEAR)

    def turns(self, displacement: np.ndarray) -> np.ndarray:
        """Return turns U (M,) of each kind that make `displacement` (N,) [m], Σ answer_im U_m.

        They minimise the time Σ seconds_m |U_m|, by reweighted least squares (Chartrand and Yin,
        ICASSP 2008, 3869).

        Parameters
        ----------
        displacement : ndarray, shape (N,)
            Displacements, complex [m].

        Returns
        -------
        ndarray, shape (M,)
            Turns, complex.
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
        """Return the approximate time [s] for a `displacement` (N,) [m].

        Parameters
        ----------
        displacement : ndarray, shape (N,)
            Displacements, complex [m].

        Returns
        -------
        float
            Time [s].
        """
        return float(self.seconds @ np.abs(self.turns(displacement)))

    def legs(self, displacement: np.ndarray,
             slack: Callable[[np.ndarray], np.ndarray] | None = None) -> list[Leg]:
        """Return whole turns that add up to `displacement` (N,) [m], in order.

        Each step takes the turn with the smallest detour of any roller from a straight path; a
        detour that gains missing clearance may be longer. `slack` returns the clearance (C,) [m],
        negative where it lacks, after displacements (N, C) [m].

        Parameters
        ----------
        displacement : ndarray, shape (N,)
            Displacements, complex [m].
        slack : callable or None
            Function that returns the clearance (C,) [m] after displacements (N, C) [m]; None for
            no walls.

        Returns
        -------
        list of Leg
            The legs.
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
        """Return the displacements (N, L) [m] by `legs` (L).

        Parameters
        ----------
        legs : list of Leg
            The legs.

        Returns
        -------
        ndarray, shape (N, L)
            Displacements, complex [m].
        """
        way = np.array([leg.way for leg in legs], complex)
        return np.asarray(self.answer[:, [leg.kind for leg in legs]] * way)

    def learn(self, leg: Leg, moved: np.ndarray) -> None:
        """Update the responses by displacements `moved` (N,) [m] measured after a `leg`.

        Parameters
        ----------
        leg : Leg
            The leg.
        moved : ndarray, shape (N,)
            Displacements, complex [m].
        """
        off = moved / leg.way - self.answer[:, leg.kind]
        self.answer[:, leg.kind] += _FAITH * off


def _whole(kind: int, u: complex) -> Iterator[Leg]:
    """Yield unit steps that add up to u: straight ones, and two at an angle for the remainder."""
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
