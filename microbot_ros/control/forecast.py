"""Where the particles will be when a command given now takes effect."""

from __future__ import annotations

import dataclasses
from collections import deque

import numpy as np

from microbot_ros.control.contract import Situation

KNOWN_WELL_ENOUGH = 0.5
"""Standard deviation of φ [rad] up to which a forecast beats the measured position."""


class Forecast:
    """Remembers the commands and carries positions from their exposure over the delay.

    By the first-order model: a particle moves v e^{iφ} ∫u dt, u the field's direction as a
    complex number, which it keeps when the field goes to zero; a roller as far as it is rotated.
    """

    def __init__(self) -> None:
        self._steps: deque[tuple[float, complex, float]] = deque(maxlen=256)

    def clear(self) -> None:
        """Forget the commands: what the particles did meanwhile is not known."""
        self._steps.clear()

    def note(self, t: float, field: np.ndarray, frequency: float) -> None:
        """From `t` [s] on the field (2,) [T] acts, rotating at `frequency` [Hz] for rollers."""
        strength = complex(*field.tolist())
        before = self._steps[-1][1] if self._steps else 0j
        direction = strength / abs(strength) if strength else before
        self._steps.append((t, direction, frequency))

    def look_ahead(self, situation: Situation) -> Situation:
        """The situation with `expected` (N, 2) filled in, the measured position where φ is not
        known well enough to do better."""
        rolling = situation.model is not None and situation.model.propulsion == 'rolling'
        begin, end = situation.t - situation.age, situation.t + situation.delay
        displacement = 0j
        for t, direction, frequency in reversed(self._steps):
            if t < end:
                displacement += direction * (frequency if rolling else 1) * (end - max(t, begin))
                end = max(t, begin)
            if t <= begin:
                break
        known = situation.learned(KNOWN_WELL_ENOUGH) & np.isfinite(situation.speed)
        moved = np.zeros((len(known), 2))
        velocity = situation.speed[known] * np.exp(1j * situation.phi[known])
        moved[known] = (velocity * displacement).view(float).reshape(-1, 2)
        return dataclasses.replace(situation, expected=situation.position + moved)
