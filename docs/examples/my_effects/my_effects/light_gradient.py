"""The lamp is brighter on one side, and brighter light makes faster particles."""

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter

ACROSS = 100e-6
"""Distance [m] for which the parameters state the change."""


@dataclass(frozen=True)
class LightGradient(Effect):
    """v → v (1 + (east · x + north · y) / 100 µm), never below zero.

    For particles whose speed is proportional to the light, in light that changes evenly from
    one side of the picture to the other; 1 at the origin of the workspace.
    """

    id = 'light_gradient'
    stage = 'velocity'
    summary = 'Particles are faster on one side of the picture.'
    required_excitation = 'tracks that cross the picture, in several directions'
    confounded_with = ('speed_decay', 'linear_flow', 'hot_spot')
    needs_position = True

    east: float = parameter('east', 'growth of the speed over 100 µm to the right', -2, 2, 0.1)
    north: float = parameter('north', 'growth of the speed over 100 µm upwards', -2, 2, 0.1)

    def speed_factor(self, context: EffectContext) -> np.ndarray:
        x, y = np.moveaxis(context.position, -1, 0)
        return np.maximum(1 + (self.east * x + self.north * y) / ACROSS, 0.0)
