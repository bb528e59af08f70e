"""Oscillation of the liquid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter

PERIODS = 2.0
"""Fewest periods in a recording of an oscillation. Choice: less is a trend."""

_PEAKS = 6
"""Number of peaks of a periodogram that are evaluated. Choice: more cost time."""


@dataclass(frozen=True)
class PeriodicDrift(Effect):
    """dp/dt += a cos(2πft + ψ), a = amplitude along one direction, t the time of the session."""

    id = 'periodic_drift'
    stage = 'velocity'
    summary = 'All particles oscillate at one frequency, whatever the command.'
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
    def starts(cls, evidence: Evidence) -> Sequence[Self]:
        """Return the largest peaks of the residual, both rotations: any ellipse counts."""
        frequency, forward, back = evidence.swings()
        power = np.abs(forward) ** 2 + np.abs(back) ** 2
        known = next(p for p in cls.parameters() if p.field == 'frequency')
        peaks = [k for k in np.argsort(-power) if power[k] == power[max(k - 3, 0):k + 4].max()
                 and known.low <= frequency[k] <= known.high]
        return evidence.promising(
            [cls._turning(float(frequency[k]), forward[k], back[k]) for k in peaks[:_PEAKS]],
            # As `trials` counts.
            price=lambda start: float(2 * np.log(start.frequency * evidence.duration)))

    @classmethod
    def _turning(cls, frequency: float, forward: complex, back: complex) -> Self:
        """Return an effect of zero strength with the direction and phase of two amplitudes.

        x + iy = ½ a (e^{i(α+ψ)} e^{iωt} + e^{i(α−ψ)} e^{−iωt}): the two rotating parts.
        """
        ahead, behind = np.angle(forward), np.angle(back)
        direction, phase = (ahead + behind) / 2, (ahead - behind) / 2
        # The opposite direction half a period later is the same: directions are within 0 and π.
        turns = np.floor(direction / np.pi)
        direction -= turns * np.pi
        phase = (phase - turns * np.pi + np.pi) % (2 * np.pi) - np.pi
        return cls(0.0, frequency, float(direction), float(phase))

    def trials(self, evidence: Evidence) -> float:
        """Return the number of frequencies, with equal prior probability for each octave.

        An oscillation may have any frequency. There are more high ones, and each pays for all.
        """
        periods = self.frequency * evidence.duration
        return float(max(periods * np.log(evidence.fastest * evidence.duration / PERIODS), 1.0))

    def shape_seen(self, evidence: Evidence) -> bool:
        """Return whether the recording has PERIODS, and whether the oscillation is a line.

        Half a period could be anything smooth. A peak of broad noise is no oscillation: a small
        error of the response to commands has as broad a spectrum as they have.
        """
        if not self.within_bounds() or self.frequency * evidence.duration < PERIODS:
            return False
        return evidence.is_line(self, self.frequency, self.direction)
