"""Direction in which the field drives the particles, integrated between two frames."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

_MOST = 10_000
"""Choice: commands kept while no frame arrives."""


class Drive:
    """Drive over time: each command holds until the next; before the first there is none.

    A drive is the direction in which the field would move a particle with φ = 0: of length one for
    swimmers, which have their own speed, and of the rotation frequency [Hz] for rollers.
    """

    def __init__(self) -> None:
        self._commands: deque[tuple[float, complex]] = deque(maxlen=_MOST)

    def command(self, t: float, drive: np.ndarray) -> None:
        """Set the `drive` (2,) from `t` [s] on; values that are not finite are ignored.

        A time before the last one replaces what was known from there on.

        Parameters
        ----------
        t : float
            Time [s].
        drive : ndarray, shape (2,)
            The drive.
        """
        x, y = map(float, drive)
        if not all(map(math.isfinite, (t, x, y))):
            return
        while self._commands and self._commands[-1][0] >= t:
            self._commands.pop()
        self._commands.append((t, complex(x, y)))

    def between(self, start: float, end: float) -> np.ndarray:
        """Return the drive (2,) integrated from `start` to `end` [s]; forget what came before.

        Parameters
        ----------
        start : float
            Beginning [s].
        end : float
            End [s].

        Returns
        -------
        ndarray, shape (2,)
            The integral.
        """
        while len(self._commands) > 1 and self._commands[1][0] <= start:
            self._commands.popleft()
        total, until = 0j, end
        for t, drive in reversed(self._commands):
            since = max(t, start)
            if since < until:
                total += drive * (until - since)
                until = since
        return np.array([total.real, total.imag])
