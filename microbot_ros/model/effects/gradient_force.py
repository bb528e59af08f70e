"""The field is not uniform and pulls outwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import parameter
from microbot_ros.model.scene import Scene


@dataclass(frozen=True)
class GradientForce(Effect):
    """dp/dt += k |B| p, about the origin, B the field after stage 1.

    The force V(M·∇)B of coils whose field differs from that at the centre in proportion to the
    distance, divided by Stokes drag.
    """

    id = 'gradient_force'
    stage = 'velocity'
    summary = 'Particles are pushed away from the centre, more in a stronger field.'
    shows_under = 'positions spread over the workspace, at two field strengths or more'
    mistaken_for = ('linear_flow', 'hot_spot')
    needs_position = True

    rate: float = parameter('rate_per_s_mT', 'k', -1e3, 1e3, 1.0)

    def drift(self, scene: Scene) -> np.ndarray:
        return self.rate * scene.strength[..., None] * scene.position
