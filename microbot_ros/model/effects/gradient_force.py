"""The field of crossed pairs of coils is not uniform, and pulls where it is stronger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.evidence import Evidence
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class GradientForce(Effect):
    """dp/dt += k |B| M p, M = [[2c² − s², −2cs], [−2cs, 2s² − c²]], about the origin.

    c and s are those of the angle of B, the field after stage 1. |B| M p is ∇|B|/a near the
    centre of two equal pairs of coaxial coils along x and y (derived in
    docs/explanation/magnetics.md from ∇·B = 0 and ∇×B = 0), a = B''/2B on a pair's axis.
    k = a m/(6πηr): the force m ∇|B| on a moment m along the field, divided by Stokes drag.
    """

    id = 'gradient_force'
    stage = 'velocity'
    summary = 'Particles are pulled to where the coils make the field stronger.'
    required_excitation = 'positions spread over the workspace, under fields all round'
    confounded_with = ('linear_flow', 'hot_spot')
    proportional = True
    needs_position = True

    rate: float = parameter('rate_per_s_mT', 'k', -1e3, 1e3, 1.0)

    def drift(self, context: EffectContext) -> np.ndarray:
        p, strength = context.position, context.strength[..., None]
        u = context.field / np.maximum(strength, np.finfo(float).tiny)
        pulled = 5 * u**2 * p - 2 * u * (u * p).sum(axis=-1, keepdims=True) - p
        return np.asarray(self.rate * strength * pulled)

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.strength_known
