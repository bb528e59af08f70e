"""Steady flow that carries all particles equally."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class UniformDrift(Effect):
    """dp/dt += w."""

    id = 'uniform_drift'
    stage = 'velocity'
    summary = 'All particles drift at the same velocity, whatever the command.'
    required_excitation = (
        'commands whose directions average out, so that propulsion does not hide it')
    confounded_with = ('background_field', 'linear_flow', 'periodic_drift', 'hot_spot')
    proportional = True
    lookalike_time = 210.0  # a flow that differs from place to place: docs/decisions/asking.md

    wx: float = parameter('wx_um_s', 'drift to the right', -1e-4, 1e-4, 1e-6)
    wy: float = parameter('wy_um_s', 'drift upwards', -1e-4, 1e-4, 1e-6)

    def drift(self, context: EffectContext) -> np.ndarray:
        return np.array([[self.wx, self.wy]])
