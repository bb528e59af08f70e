"""Exhaustion of the fuel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class SpeedDecay(Effect):
    """v → v exp(−t/T), t the time of the session."""

    id = 'speed_decay'
    stage = 'velocity'
    summary = 'All particles slow down exponentially as the fuel is used up.'
    required_excitation = (
        'a recording of a large part of the decay that returns to earlier positions')
    confounded_with = ('hot_spot', 'incomplete_alignment', 'drive_response')
    time_invariant = False
    lookalike_time = 54.0  # a lamp, or warmth, that changes: docs/decisions/asking.md

    tau: float = parameter(
        'tau_s', 'time in which the speed falls to 1/e', 1.0, np.inf, 100.0,
        null_value=np.inf, inverse=True,
    )

    def speed_factor(self, context: EffectContext) -> np.ndarray:
        half = context.span / (2 * self.tau)
        mean = np.divide(np.sinh(half), half, out=np.ones_like(half), where=half != 0)
        return np.exp(-context.t / self.tau) * mean

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        """Return whether the particles burn fuel: rollers do not."""
        return evidence.propulsion == 'catalytic'
