"""The liquid swings to and fro."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from microbot_ros.model.effect import Effect, Recorded
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class PeriodicDrift(Effect):
    """dp/dt += a cos(2πft + ψ), a = amplitude along one direction, t the time of the session."""

    id = 'periodic_drift'
    stage = 'velocity'
    summary = 'Every particle is swung to and fro at one frequency, whatever is commanded.'
    required_excitation = (
        'a recording of several periods; commands that do not repeat at the same period')
    confounded_with = ('uniform_drift',)
    proportional = True
    time_invariant = False

    amplitude: float = parameter('amplitude_um_s', 'largest velocity', -1e-4, 1e-4, 1e-6)
    frequency: float = parameter(
        'frequency_hz', 'f', 1e-3, 10.0, 0.1, null_value=0.1, shape=True,
    )
    direction: float = parameter(
        'direction_rad', 'direction of the swing', -np.pi, np.pi, 1.0, shape=True, default=0.0,
    )
    phase: float = parameter('phase_rad', 'ψ', -np.pi, np.pi, 1.0, shape=True, default=0.0)

    def drift(self, context: EffectContext) -> np.ndarray:
        swing = np.cos(2 * np.pi * self.frequency * context.t + self.phase)
        swing *= self.amplitude * np.sinc(self.frequency * context.span)
        return swing[..., None] * np.array([np.cos(self.direction), np.sin(self.direction)])

    @classmethod
    def starts(cls, recorded: Recorded) -> tuple[Self, ...]:
        """Along x and y, in and out of phase, from one period a recording up to 3 Hz."""
        duration = recorded.times[-1] - recorded.times[0]
        quarters = (0.0, np.pi / 2)
        return tuple(
            cls(0.0, frequency, direction, phase)
            for frequency in np.arange(1.0, 3.0 * duration, 0.5) / duration
            for direction in quarters for phase in quarters
        )
