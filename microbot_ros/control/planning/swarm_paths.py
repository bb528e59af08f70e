"""Ways for many particles at once, past each other and past walls: prioritised planning.

One particle after the other gets the way on a grid that reaches its goal first while it keeps off
those planned before it, wherever they are at that time (Erdmann and Lozano-Pérez, Algorithmica 2,
477 (1987)). Then all ways are drawn tight together. Positions are complex numbers [m].
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from microbot_ros.control.contract import NoSolutionError, Workspace

_CELL = 4e-6
_LAYERS = 2
"""Time steps of a search between two pauses."""
_LONGEST = 400
"""Time steps after which no way is looked for."""
_ORDERS = 12
"""In how many orders the particles are planned before it is given up."""
_TIGHTENED = 100
_AT_ONCE = 3
"""Ways that are tightened between two pauses."""


@dataclass(frozen=True)
class Room:
    """Where particles may be: in a `view`, `off_walls` [m] from every one of `walls` (W, 2), from
    end to end as complex numbers, and `apart` [m] from each other.
    """

    view: Workspace
    walls: np.ndarray
    apart: float
    off_walls: float

    def to_walls(self, place: np.ndarray) -> np.ndarray:
        """How far each `place` (...) [m] is from the nearest wall or border of the view (...)."""
        low, high = complex(*self.view.low), complex(*self.view.high)
        sides = [place.real - low.real, place.imag - low.imag,
                 high.real - place.real, high.imag - place.imag]
        for begin, end in self.walls:
            along = ((place - begin) * np.conj(end - begin)).real / abs(end - begin) ** 2
            sides.append(np.abs(place - begin - np.clip(along, 0, 1) * (end - begin)))
        return np.asarray(np.min(sides, axis=0))


def between(place: np.ndarray) -> np.ndarray:
    """How far each of `place` (..., N) [m] is from its nearest neighbour (..., N); inf alone."""
    distance = np.abs(place[..., :, None] - place[..., None, :])
    distance[..., np.arange(place.shape[-1]), np.arange(place.shape[-1])] = np.inf
    return np.asarray(distance.min(-1))


def find_ways(start: np.ndarray, goal: np.ndarray, room: Room,
              ) -> Generator[None, None, np.ndarray]:
    """Where all are (K, N) [m], one time step after the other, from `start` (N,) to `goal` (N,).

    A generator, whose value it is: it pauses every some milliseconds, for whoever has more to do.
    NoSolutionError where none is found in that `room`.
    """
    rng = np.random.default_rng(0)
    search = _Search(start, goal, room)
    order = np.argsort(np.abs(goal - start))
    for _ in range(_ORDERS):
        ways = yield from search.run(order.tolist())
        if ways is not None:
            return (yield from _tightened(ways, room))
        order = rng.permutation(order)
    raise NoSolutionError('found no ways to all goals, past each other and the walls')


class _Search:
    """The grid and what is known of it; ends count as they are, though they lie between cells."""

    def __init__(self, start: np.ndarray, goal: np.ndarray, room: Room) -> None:
        self._start, self._goal, self._room = start, goal, room
        low, high = room.view.low, room.view.high
        x, y = (np.arange(a, b, _CELL) for a, b in zip(low, high, strict=True))
        self._place = x[:, None] + 1j * y[None, :]
        free = room.to_walls(self._place) >= room.off_walls
        self._free = np.pad(free, 1)

    def run(self, order: list[int]) -> Generator[None, None, np.ndarray | None]:
        """All ways (K, N), planned in an `order`; None where one of them has none."""
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
        """The quickest of one past `others` that have theirs, or None."""
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
        """Of the free ones, counted with the frame about the grid, the nearest."""
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
        """Nobody comes near to a place, though its cell may be a little off."""
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
        """The cells (K,) [m] that led there, moving as late as possible."""
        cells, here = [end], end
        for before in reversed(reached[:-1]):
            here = next((here[0] + i, here[1] + j) for i, j in _MOVES
                        if before[here[0] + i, here[1] + j])
            cells.append(here)
        i, j = np.array(cells[::-1]).T
        return np.asarray(self._place[i - 1, j - 1])


_MOVES = sorted(((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)),
                key=lambda move: abs(move[0]) + abs(move[1]))


def _spread(cells: np.ndarray) -> np.ndarray:
    """The cells and their eight neighbours; none on the frame."""
    wide = cells.copy()
    wide[1:] |= cells[:-1]
    wide[:-1] |= cells[1:]
    tall = wide.copy()
    tall[:, 1:] |= wide[:, :-1]
    tall[:, :-1] |= wide[:, 1:]
    return tall


def _tightened(ways: np.ndarray, room: Room) -> Generator[None, None, np.ndarray]:
    """Drawn tight like rubber bands (K, N), as far as nobody comes too near to anything by it.

    One after the other gives way, at every other time; who is too near as it is may come off.
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
    """How much nearer (K,) [m] one on its `way` (K,) could be to `others` (K, N), and to walls."""
    near = np.abs(way[:, None] - others).min(-1, initial=np.inf)
    return np.asarray(np.minimum(near - room.apart, room.to_walls(way) - room.off_walls))
