"""What the field did and will do: the commands on their way, and what they add up to."""

from __future__ import annotations

from collections import deque

import numpy as np


class FieldRecord:
    """The commands of the last seconds, by the time at which each begins to act."""

    def __init__(self) -> None:
        self._steps: deque[tuple[float, complex, float]] = deque(maxlen=256)

    def clear(self) -> None:
        """Forget the commands: what the particles did meanwhile is not known."""
        self._steps.clear()

    def reaches(self, t: float) -> bool:
        """Whether all that acted since `t` [s] is known."""
        return bool(self._steps) and self._steps[0][0] <= t

    def note(self, t: float, field: np.ndarray, frequency: float) -> None:
        """From `t` [s] on the field (2,) [T] acts, rotating at `frequency` [Hz] for rollers.

        Particles keep their direction when the field goes to zero.
        """
        strength = complex(*field.tolist())
        before = self._steps[-1][1] if self._steps else 0j
        direction = strength / abs(strength) if strength else before
        self._steps.append((t, direction, frequency))

    def shared(self, begin: float, end: float, rolling: bool = False) -> complex:
        """∫u dt [s] from `begin` to `end`, u the field's direction as a complex number.

        For `rolling` particles ∫f u dt, in turns. Nothing before the first command known.
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
