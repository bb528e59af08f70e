"""Axes of the two coil pairs that are not perpendicular."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import ALIKE, parameter


@dataclass(frozen=True)
class CoilMisalignment(Effect):
    """The y coils’ axis leans by s: B = [[1, sin s], [0, cos s]] B_cmd."""

    id = 'coil_misalignment'
    stage = 'field'
    summary = 'The axis of the y coils is tilted towards that of the x coils.'
    required_excitation = 'commands in all directions'
    confounded_with = ('background_field', 'coil_gain_mismatch')

    skew: float = parameter('skew_rad', 'lean of the y axis towards +x', -1.0, 1.0, 0.1,
                            floor=ALIKE)

    def field(self, B: np.ndarray) -> np.ndarray:
        lean = np.array([[1.0, np.sin(self.skew)], [0.0, np.cos(self.skew)]])
        # As one product: stacks of rows are multiplied one by one.
        return (B.reshape(-1, 2) @ lean.T).reshape(B.shape)
