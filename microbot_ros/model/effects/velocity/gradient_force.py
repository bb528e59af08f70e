"""Pull towards stronger field between crossed pairs of coils."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class GradientForce(Effect):
    """dp/dt += k |B| M p, M = [[2c² − s², −2cs], [−2cs, 2s² − c²]], about the origin.

    c and s are cosine and sine of the angle of B, the field after stage 1. |B| M p is ∇|B|/a near
    the centre of two equal pairs of coaxial coils along x and y (derived in
    docs/explanation/magnetics.md from ∇·B = 0 and ∇×B = 0), with a = B''/2B on a pair's axis. k =
    a m/(6πηr): the force m ∇|B| on a moment m along the field, divided by Stokes drag.
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
        x, y = np.moveaxis(context.position, -1, 0)
        c, s = np.moveaxis(context.field, -1, 0) / np.maximum(
            context.strength, np.finfo(float).tiny)
        k = self.rate * context.strength
        xx, xy, yy = k * (2 * c**2 - s**2), -2 * k * c * s, k * (2 * s**2 - c**2)
        return np.stack([xx * x + xy * y, xy * x + yy * y], axis=-1)

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.strength_known
