"""The fuel runs out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import parameter
from microbot_ros.model.scene import Scene


@dataclass(frozen=True)
class SpeedDecay(Effect):
    """v → v exp(−t/T), t the time of the session."""

    id = 'speed_decay'
    stage = 'velocity'
    summary = 'All particles slow down exponentially as the fuel is used up.'
    shows_under = 'a recording of a good part of the decay that returns to earlier places'
    mistaken_for = ('hot_spot', 'incomplete_alignment', 'drive_response')
    steady = False

    tau: float = parameter(
        'tau_s', 'time in which the speed falls to 1/e', 1.0, np.inf, 100.0,
        neutral=np.inf, inverse=True,
    )

    def speed_factor(self, scene: Scene) -> np.ndarray:
        half = scene.span / (2 * self.tau)
        mean = np.divide(np.sinh(half), half, out=np.ones_like(half), where=half != 0)
        return np.exp(-scene.t / self.tau) * mean
