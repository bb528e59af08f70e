"""Constant field without a command: of the Earth, a magnet, or an amplifier's offset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.parameter import COILS, parameter


@dataclass(frozen=True)
class BackgroundField(Effect):
    """B = B_cmd + b."""

    id = 'background_field'
    stage = 'field'
    summary = 'A constant field adds to the commanded one and bends the heading.'
    required_excitation = (
        'commands in all directions, best at two field magnitudes: it bends as 1/|B|')
    confounded_with = ('uniform_drift', 'coil_gain_mismatch', 'coil_misalignment')

    bx: float = parameter('bx_mT', 'background field to the right', -2e-2, 2e-2, 1e-4,
                          floor=COILS)
    by: float = parameter('by_mT', 'background field upwards', -2e-2, 2e-2, 1e-4,
                          floor=COILS)

    def field(self, B: np.ndarray) -> np.ndarray:
        return B + np.array([self.bx, self.by])

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.strength_known
