"""Different gains of the two coil pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import ALIKE, parameter


@dataclass(frozen=True)
class CoilGainMismatch(Effect):
    """B = diag(1, g) B_cmd.

    Bounds of g: coils in series and in parallel differ by 2; above 2.5 a pair has failed.
    """

    id = 'coil_gain_mismatch'
    stage = 'field'
    summary = 'The y coils make a field of other strength than the x coils for the same command.'
    required_excitation = (
        'commands in all directions, best with a background field known to be small')
    confounded_with = (
        'background_field', 'coil_misalignment', 'amplifier_deadband', 'pixel_anisotropy',
    )

    gain_ratio: float = parameter(
        'gain_ratio', 'y coils over x coils', 0.4, 2.5, 0.1, null_value=1.0, floor=ALIKE,
    )

    def field(self, B: np.ndarray) -> np.ndarray:
        return B * np.array([1.0, self.gain_ratio])
