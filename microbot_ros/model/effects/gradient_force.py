"""The field is not uniform and pulls outwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.evidence import Evidence
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class GradientForce(Effect):
    """dp/dt += k |B| p, about the origin, B the field after stage 1.

    The force V(M·∇)B of coils whose field differs from that at the centre in proportion to the
    distance, divided by Stokes drag.
    """

    id = 'gradient_force'
    stage = 'velocity'
    summary = 'Particles are pushed away from the centre, more in a stronger field.'
    required_excitation = 'positions spread over the workspace, at two field strengths or more'
    confounded_with = ('linear_flow', 'hot_spot')
    needs_position = True

    rate: float = parameter('rate_per_s_mT', 'k', -1e3, 1e3, 1.0)

    def drift(self, context: EffectContext) -> np.ndarray:
        return self.rate * context.strength[..., None] * context.position

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.strength_known
