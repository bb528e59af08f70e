"""The angle between field and travel creeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import parameter
from microbot_ros.model.scene import Scene


@dataclass(frozen=True)
class HeadingSlip(Effect):
    """φ → φ + ω t, t the time of the session."""

    id = 'heading_slip'
    stage = 'heading'
    summary = 'The angle between the field and the direction of travel changes steadily.'
    shows_under = 'a long recording; a command that does not itself turn at a steady rate'
    mistaken_for = ('alignment_lag', 'command_delay')
    steady = False

    rate: float = parameter('rate_rad_s', 'rate at which φ grows', -1.0, 1.0, 0.01)

    def heading_offset(self, scene: Scene) -> np.ndarray:
        return self.rate * scene.t
