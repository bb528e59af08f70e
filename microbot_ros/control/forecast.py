"""What the field did and will do: the commands on their way, and how far they carry particles."""

from __future__ import annotations

import dataclasses
from collections import deque

import numpy as np

from microbot_ros.control.contract import Situation

KNOWN_WELL_ENOUGH = 0.5
"""Standard deviation of φ [rad] up to which a forecast beats the measured position."""


class FieldRecord:
    """The commands of the last seconds, by the time at which each begins to act."""

    def __init__(self) -> None:
        self._steps: deque[tuple[float, complex, float]] = deque(maxlen=256)

    def clear(self) -> None:
        """Forget the commands: what the particles did meanwhile is not known."""
        self._steps.clear()

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


def look_ahead(situation: Situation, record: FieldRecord) -> Situation:
    """The situation with `expected` (N, 2) filled in by the first-order model.

    A particle moves v e^{iφ} ∫u dt from its exposure until a command of now takes effect. Where
    φ is not known well enough to do better, the measured position stands.
    """
    rolling = situation.model is not None and situation.model.propulsion == 'rolling'
    begin, end = situation.t - situation.age, situation.t + situation.delay
    known = situation.learned(KNOWN_WELL_ENOUGH) & np.isfinite(situation.speed)
    velocity = situation.speed[known] * np.exp(1j * situation.phi[known])
    moved = np.zeros((len(known), 2))
    moved[known] = (velocity * record.shared(begin, end, rolling)).view(float).reshape(-1, 2)
    return dataclasses.replace(situation, expected=situation.position + moved)
