"""Flow that grows linearly from the origin: shear, strain or vortex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class LinearFlow(Effect):
    """dp/dt += G p, about the origin of the workspace."""

    id = 'linear_flow'
    stage = 'velocity'
    summary = (
        'The liquid flows, faster with distance from the origin: shear, stretching or a vortex.')
    required_excitation = 'positions spread over the workspace and visited more than once'
    confounded_with = ('uniform_drift', 'hot_spot', 'gradient_force')
    proportional = True
    lookalike_time = 210.0  # a flow that differs from place to place: docs/decisions/asking.md
    needs_position = True

    gxx: float = parameter('gxx_per_s', 'd v_x / d x', -1.0, 1.0, 1e-2)
    gxy: float = parameter('gxy_per_s', 'd v_x / d y', -1.0, 1.0, 1e-2)
    gyx: float = parameter('gyx_per_s', 'd v_y / d x', -1.0, 1.0, 1e-2)
    gyy: float = parameter('gyy_per_s', 'd v_y / d y', -1.0, 1.0, 1e-2)

    def drift(self, context: EffectContext) -> np.ndarray:
        place, flow = context.position, np.array([[self.gxx, self.gyx], [self.gxy, self.gyy]])
        # As one product: stacks of rows are multiplied one by one.
        return (place.reshape(-1, 2) @ flow).reshape(place.shape)
