"""Dead band of an amplifier about zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import COILS, parameter


@dataclass(frozen=True)
class AmplifierDeadband(Effect):
    """Each axis loses its first b: Bₖ = sign(Bₖ) max(|Bₖ| − b, 0), before the coils.

    For rollers of unknown field strength, b is in units of the nominal field of 1 mT: a dead band
    of 0.11 mT is 11 % of full scale.
    """

    id = 'amplifier_deadband'
    stage = 'field'
    summary = 'Each axis of the field loses a fixed amount, and is zero below it.'
    required_excitation = (
        'commands in all directions, best weak ones: headings bend towards the axes')
    confounded_with = ('coil_gain_mismatch', 'incomplete_alignment')

    deadband: float = parameter('deadband_mT', 'field that each axis loses', 0.0, 1e-2, 1e-4,
                                floor=COILS)

    def field(self, B: np.ndarray) -> np.ndarray:
        return np.copysign(np.maximum(np.abs(B) - self.deadband, 0.0), B)
