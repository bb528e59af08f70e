"""Pull towards a single coil that makes the field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class CoilPull(Effect):
    """dp/dt += k B, B the field after stage 1.

    On the axis of a single coil ∇|B| points to the coil and equals g|B|, the same at all places
    near the centre; the field points to the coil. k = g m/(6πηr), as for `gradient_force`. For g,
    and for several coils on one side each, see docs/explanation/magnetics.md.
    """

    id = 'coil_pull'
    stage = 'velocity'
    summary = 'All particles are pulled along the field, towards the coil that makes it.'
    required_excitation = 'several field strengths; at one alone v and φ absorb it'
    confounded_with = ('incomplete_alignment', 'drive_response')
    proportional = True

    rate: float = parameter('rate_um_s_mT', 'k', -1e-1, 1e-1, 1e-4)

    def drift(self, context: EffectContext) -> np.ndarray:
        return self.rate * context.field

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.strength_known
