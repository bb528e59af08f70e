"""The camera’s pixels are not square."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class PixelAnisotropy(Effect):
    """measured = diag(1, a) true."""

    id = 'pixel_anisotropy'
    stage = 'observation'
    summary = 'The picture is stretched along one axis.'
    required_excitation = 'commands in all directions'
    confounded_with = ('coil_gain_mismatch',)

    aspect: float = parameter('aspect', 'y over x', 0.2, 5.0, 0.1, null_value=1.0)

    def observe(self, position: np.ndarray) -> np.ndarray:
        return position * np.array([1.0, self.aspect])

    def true_position(self, observed: np.ndarray) -> np.ndarray:
        return observed / np.array([1.0, self.aspect])
