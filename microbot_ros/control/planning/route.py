"""Path as a curve: arc length, distance and direction at a particle."""

from __future__ import annotations

import numpy as np

from microbot_ros.control.planning.shared import as_complex


class Route:
    """Polyline through `points` (P, 2) [m]; closed if the last point repeats the first.

    Its direction turns evenly along each segment, so that a densely sampled curve is followed
    smoothly. Raises ValueError for fewer than two different points or points that are not finite.

    Parameters
    ----------
    points : ndarray, shape (P, 2)
        Points [m].
    """

    def __init__(self, points: np.ndarray) -> None:
        z = as_complex(np.asarray(points, dtype=float).reshape(-1, 2))
        if not np.isfinite(z).all():
            raise ValueError('a path must be finite')
        z = z[np.abs(np.diff(z, prepend=np.nan)) != 0]
        if len(z) < 2:
            raise ValueError('a path must have two different points')
        self.closed = bool(z[0] == z[-1])
        self._start, self._step = z[:-1], np.diff(z)
        self._length = np.abs(self._step)
        self._along = np.concatenate([[0.0], np.cumsum(self._length)])
        self._turn = self._directions()

    def _directions(self) -> np.ndarray:
        """Return the direction at each vertex, the mean of the adjacent segments."""
        ways = self._step / self._length
        before, after = np.concatenate([ways[:1], ways]), np.concatenate([ways, ways[-1:]])
        if self.closed:
            before[0], after[-1] = ways[-1], ways[0]
        mean = before + after
        mean = np.where(np.abs(mean) < 1e-3, after, mean)
        return np.asarray(mean / np.abs(mean))

    @property
    def length(self) -> float:
        """Length from the first point to the last [m]."""
        return float(self._along[-1])

    @property
    def end(self) -> complex:
        """Last point [m]."""
        return complex(self._start[-1] + self._step[-1])

    def nearest(self, place: complex, after: float | None, reach: float) -> float:
        """Return the arc length [m] of the point nearest to `place` [m].

        With `after` [m], only from a little before it to `reach` [m] beyond, so that a particle
        stays on its branch where the route crosses itself.

        Parameters
        ----------
        place : complex
            Position, complex [m].
        after : float or None
            Arc length from which to search [m]; None for all.
        reach : float
            Length of the search [m].

        Returns
        -------
        float
            Arc length [m].
        """
        part = np.clip(
            ((place - self._start) * self._step.conj()).real / self._length**2, 0, 1)
        away = np.abs(self._start + part * self._step - place)
        along = self._along[:-1] + part * self._length
        if after is not None:
            ahead = along - after
            if self.closed:
                ahead = (ahead + self.length / 2) % self.length - self.length / 2
            away = np.where((-reach / 4 <= ahead) & (ahead <= reach), away, np.inf)
            if not np.isfinite(away).any():
                return after
        return float(along[np.argmin(away)])

    def at(self, along: float) -> tuple[complex, complex]:
        """Return the point and the unit direction at arc length `along` [m].

        Parameters
        ----------
        along : float
            Arc length [m].

        Returns
        -------
        tuple[complex, complex]
            Point [m] and unit direction, complex.
        """
        if self.closed:
            along %= self.length
        k = int(np.clip(np.searchsorted(self._along, along, side='right') - 1,
                        0, len(self._step) - 1))
        part = min(max((along - self._along[k]) / self._length[k], 0.0), 1.0)
        way = (1 - part) * self._turn[k] + part * self._turn[k + 1]
        return complex(self._start[k] + part * self._step[k]), complex(way / abs(way))
