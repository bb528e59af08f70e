"""Paths for many particles at once, past each other and past walls: prioritised planning.

One particle after the other gets the fastest path on a grid that avoids those planned before, at
all times (Erdmann and Lozano-Pérez, Algorithmica 2, 477 (1987)). Then all paths are shortened
together. Positions are complex numbers [m].
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from microbot_ros.control.contract import NoSolutionError, Workspace

_CELL = 4e-6  # choice: about a particle's diameter [m]
_LAYERS = 2
"""Choice: time steps of a search between two pauses."""
_LONGEST = 400
"""Choice: time steps after which the search for a path ends."""
_ORDERS = 12
"""Choice: orders of the particles that are tried."""
_TIGHTENED = 100  # choice: rounds of shortening
_AT_ONCE = 3
"""Choice: paths that are shortened between two pauses."""


@dataclass(frozen=True)
class Room:
    """Region open to particles.

    They stay in `view`, at least `off_walls` [m] from each of `walls` (W, 2), end points as
    complex numbers, and `apart` [m] from each other.
    """

    view: Workspace
    walls: np.ndarray
    apart: float
    off_walls: float

    def to_walls(self, place: np.ndarray) -> np.ndarray:
        """Return the distance of each `place` (...) [m] to the nearest wall or border (...).

        Parameters
        ----------
        place : ndarray
            Positions, complex, of any shape [m].

        Returns
        -------
        ndarray
            Distances [m], of the same shape.
        """
        low, high = complex(*self.view.low), complex(*self.view.high)
        sides = [place.real - low.real, place.imag - low.imag,
                 high.real - place.real, high.imag - place.imag]
        for begin, end in self.walls:
            along = ((place - begin) * np.conj(end - begin)).real / abs(end - begin) ** 2
            sides.append(np.abs(place - begin - np.clip(along, 0, 1) * (end - begin)))
        return np.asarray(np.min(sides, axis=0))


def between(place: np.ndarray) -> np.ndarray:
    """Return the distance of each `place` (..., N) [m] to its nearest neighbour; inf if alone.

    Parameters
    ----------
    place : ndarray, shape (..., N)
        Positions, complex [m].

    Returns
    -------
    ndarray, shape (..., N)
        Distances [m].
    """
    distance = np.abs(place[..., :, None] - place[..., None, :])
    distance[..., np.arange(place.shape[-1]), np.arange(place.shape[-1])] = np.inf
    return np.asarray(distance.min(-1))


def find_ways(start: np.ndarray, goal: np.ndarray, room: Room,
              ) -> Generator[None, None, np.ndarray]:
    """Return positions (K, N) [m] over time steps, from `start` (N,) to `goal` (N,).

    A generator with that value: it yields every few milliseconds, to let other work go on. Raises
    NoSolutionError if no paths are found in `room`.

    Parameters
    ----------
    start : ndarray, shape (N,)
        Positions, complex [m].
    goal : ndarray, shape (N,)
        Goals, complex [m].
    room : Room
        The room.

    Returns
    -------
    Generator[None, None, ndarray], shape (K, N)
        Positions, complex [m].
    """
    rng = np.random.default_rng(0)
    search = _Search(start, goal, room)
    order = np.argsort(np.abs(goal - start))
    for _ in range(_ORDERS):
        ways = yield from search.run(order.tolist())
        if ways is not None:
            return (yield from _tightened(ways, room))
        order = rng.permutation(order)
    raise NoSolutionError('found no paths to all goals that avoid the other particles and the '
                          'walls')


class _Search:
    """Grid of the search; start and goal are exact, even between cells."""

    def __init__(self, start: np.ndarray, goal: np.ndarray, room: Room) -> None:
        self._start, self._goal, self._room = start, goal, room
        low, high = room.view.low, room.view.high
        x, y = (np.arange(a, b, _CELL) for a, b in zip(low, high, strict=True))
        self._place = x[:, None] + 1j * y[None, :]
        free = room.to_walls(self._place) >= room.off_walls
        self._free = np.pad(free, 1)

    def run(self, order: list[int]) -> Generator[None, None, np.ndarray | None]:
        """Return all paths (K, N), planned in this `order`; None if one particle has none."""
        ways: list[np.ndarray] = []
        for k in order:
            way = yield from self._way(k, ways)
            if way is None:
                return None
            ways.append(way)
        longest = max(map(len, ways))
        found = np.array([np.pad(way, (0, longest - len(way)), 'edge') for way in ways]).T
        return found[:, np.argsort(order)]

    def _way(self, k: int, others: list[np.ndarray]) -> Generator[None, None, np.ndarray | None]:
        """Return the fastest path of particle `k` past the `others`, or None."""
        begin, end = self._cell(self._start[k]), self._cell(self._goal[k])
        reached = [np.zeros_like(self._free)]
        reached[0][begin] = True
        for step in range(1, _LONGEST):
            if step % _LAYERS == 0:
                yield
            reached.append(_spread(reached[-1]) & self._open(step, others))
            if not reached[-1].any():
                return None
            if reached[-1][end] and self._stays_open(end, step, others):
                cells = self._back(reached, end)
                cells[0], cells[-1] = self._start[k], self._goal[k]
                return cells
        return None

    def _cell(self, place: complex) -> tuple[int, int]:
        """Return the free cell nearest to `place`, counted with the frame around the grid."""
        away = np.where(self._free[1:-1, 1:-1], np.abs(self._place - place), np.inf)
        i, j = np.unravel_index(np.argmin(away), away.shape)
        return int(i) + 1, int(j) + 1

    def _open(self, step: int, others: list[np.ndarray]) -> np.ndarray:
        free = self._free.copy()
        for way in others:
            for at in {way[min(step - 1, len(way) - 1)], way[min(step, len(way) - 1)]}:
                self._close(free, at)
        return free

    def _close(self, free: np.ndarray, at: complex) -> None:
        """Mark cells near the exact place `at` as occupied."""
        i, j = self._cell(at)
        reach = int(self._room.apart / _CELL) + 1
        window = np.s_[max(i - reach, 1):i + reach + 1, max(j - reach, 1):j + reach + 1]
        rows, columns = window
        near = self._place[rows.start - 1:rows.stop - 1, columns.start - 1:columns.stop - 1]
        free[window][:near.shape[0], :near.shape[1]] &= np.abs(near - at) >= self._room.apart

    def _stays_open(self, end: tuple[int, int], step: int, others: list[np.ndarray]) -> bool:
        at = self._place[end[0] - 1, end[1] - 1]
        return all((np.abs(way[min(step, len(way) - 1):] - at) >= self._room.apart).all()
                   for way in others)

    def _back(self, reached: list[np.ndarray], end: tuple[int, int]) -> np.ndarray:
        """Return the cells (K,) [m] that led to the end, with moves as late as possible."""
        cells, here = [end], end
        for before in reversed(reached[:-1]):
            here = next((here[0] + i, here[1] + j) for i, j in _MOVES
                        if before[here[0] + i, here[1] + j])
            cells.append(here)
        i, j = np.array(cells[::-1]).T
        return np.asarray(self._place[i - 1, j - 1])


_MOVES = sorted(((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)),
                key=lambda move: abs(move[0]) + abs(move[1]))
"""Moves to a neighbouring cell, by definition of the grid; short ones first."""


def _spread(cells: np.ndarray) -> np.ndarray:
    """Return the cells and their eight neighbours, without the frame."""
    wide = cells.copy()
    wide[1:] |= cells[:-1]
    wide[:-1] |= cells[1:]
    tall = wide.copy()
    tall[:, 1:] |= wide[:, :-1]
    tall[:, :-1] |= wide[:, 1:]
    return tall


def _tightened(ways: np.ndarray, room: Room) -> Generator[None, None, np.ndarray]:
    """Return shortened paths (K, N) that keep all distances.

    Particles and alternate time steps take turns; a particle that is too near already may move
    away.
    """
    ways = ways.copy()
    for turn in range(_TIGHTENED):
        some = slice(1 + turn % 2, len(ways) - 1, 2)
        for k in range(ways.shape[1]):
            if k % _AT_ONCE == 0:
                yield
            way, others = ways[some, k], np.delete(ways[some], k, axis=1)
            wanted = (ways[:-2, k] + ways[2:, k])[turn % 2::2] / 2
            slack = _slack(wanted, others, room)
            good = (slack >= 0) | (slack >= _slack(way, others, room))
            ways[some, k] = np.where(good, wanted, way)
    return ways


def _slack(way: np.ndarray, others: np.ndarray, room: Room) -> np.ndarray:
    """Return the clearance (K,) [m] of one `way` (K,) from `others` (K, N) and walls."""
    near = np.abs(way[:, None] - others).min(-1, initial=np.inf)
    return np.asarray(np.minimum(near - room.apart, room.to_walls(way) - room.off_walls))
