"""Slow change of the angle between field and travel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class HeadingSlip(Effect):
    """φ → φ + ω t, t the time of the session."""

    id = 'heading_slip'
    stage = 'heading'
    summary = 'The angle between the field and the direction of travel changes steadily.'
    required_excitation = 'a long recording; a command that does not itself turn at a steady rate'
    confounded_with = ('alignment_lag', 'command_delay')
    time_invariant = False

    rate: float = parameter('rate_rad_s', 'rate at which φ grows', -1.0, 1.0, 0.01)

    def heading_offset(self, context: EffectContext) -> np.ndarray:
        return self.rate * context.t
