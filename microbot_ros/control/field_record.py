"""Record of commanded fields, past and on their way, and their integral."""

from __future__ import annotations

from collections import deque

import numpy as np


class FieldRecord:
    """Commands of the last seconds, by the time at which each takes effect."""

    def __init__(self) -> None:
        self._steps: deque[tuple[float, complex, float]] = deque(maxlen=256)

    def clear(self) -> None:
        """Forget the commands: the motion meanwhile is not known."""
        self._steps.clear()

    def reaches(self, t: float) -> bool:
        """Return whether all commands since `t` [s] are known.

        Parameters
        ----------
        t : float
            Time since which the commands are needed [s].

        Returns
        -------
        bool
            Whether all commands since then are known.
        """
        return bool(self._steps) and self._steps[0][0] <= t

    def note(self, t: float, field: np.ndarray, frequency: float) -> None:
        """Add a command: the `field` (2,) [T] acts from `t` [s] on, rotating at `frequency` [Hz].

        Particles keep their direction when the field goes to zero.

        Parameters
        ----------
        t : float
            Time [s].
        field : ndarray, shape (2,)
            Field [T].
        frequency : float
            Frequency of the field [Hz].
        """
        strength = complex(*field.tolist())
        before = self._steps[-1][1] if self._steps else 0j
        direction = strength / abs(strength) if strength else before
        self._steps.append((t, direction, frequency))

    def shared(self, begin: float, end: float, rolling: bool = False) -> complex:
        """Return ∫u dt [s] from `begin` to `end`, u the complex direction of the field.

        For `rolling` particles ∫f u dt, in turns. Time before the first command contributes
        nothing.

        Parameters
        ----------
        begin : float
            Beginning [s].
        end : float
            End [s].
        rolling : bool
            Whether particles roll.

        Returns
        -------
        complex
            The integral [s], or for rolling particles the number of turns.
        """
        total = 0j
        for t, direction, frequency in reversed(self._steps):
            start = max(t, begin)
            if start < end:
                total += direction * (frequency if rolling else 1.0) * (end - start)
                end = start
            if t <= begin:
                break
        return total
