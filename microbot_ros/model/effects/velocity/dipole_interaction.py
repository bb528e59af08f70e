"""Attraction and repulsion of magnetised particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter
from microbot_ros.model.physics.vectors import as_vectors


@dataclass(frozen=True)
class DipoleInteraction(Effect):
    """Pair force of moments along B, ∝ r⁻⁴, over Stokes drag; missing neighbours do not count.

    Two point dipoles of equal moment m b̂, with r̂ from the neighbour to the particle and c =
    b̂·r̂, repel each other with F = 3µ₀m²/(4πr⁴) [2c b̂ + (1 − 5c²) r̂]: in line they attract with
    −2 r̂, side by side they repel with +r̂ (Yung, Landecker and Villani, Magnetic and Electrical
    Separation 9, 39, 1998, for parallel moments). Hence dpᵢ/dt += Σⱼ S/r⁴ [2c b̂ + (1 − 5c²) r̂]
    with S = 3µ₀m²/(4π · 6πηR). Without a field the moments have no common direction and there is
    no force.
    """

    id = 'dipole_interaction'
    stage = 'velocity'
    summary = 'Neighbours attract each other in line with the field and repel side by side.'
    required_excitation = 'several particles near each other, under fields of different directions'
    confounded_with = ('hydrodynamic_slowdown',)
    proportional = True
    needs_position = True

    strength: float = parameter('strength_um5_s', 'S', 0.0, 1e-21, 1e-26)

    def drift(self, context: EffectContext) -> np.ndarray:
        # With b̂ = β and r̂ = e as complex numbers the bracket is −½ e − ¼ β² ē − 5/4 β̄² e³, so the
        # sums over neighbours do not depend on the field and are made once.
        first, third = context.known_places.dipole_sums
        strength = context.strength
        field = context.field[..., 0] + 1j * context.field[..., 1]
        turn = (field / np.where(strength > 0, strength, 1.0)) ** 2
        k = -self.strength * (strength > 0)
        return as_vectors(0.5 * k * first + 0.25 * k * turn * first.conj()
                          + 1.25 * k * turn.conj() * third)

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.strength_known and evidence.has_neighbours
