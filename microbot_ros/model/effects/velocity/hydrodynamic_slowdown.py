"""Slowing of particles by their neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class HydrodynamicSlowdown(Effect):
    """vᵢ → vᵢ (1 − Σⱼ ℓ/rᵢⱼ), never below zero; missing neighbours do not count."""

    id = 'hydrodynamic_slowdown'
    stage = 'velocity'
    summary = 'Particles are slower near their neighbours.'
    required_excitation = (
        'several particles whose distances change by a large fraction of their size')
    confounded_with = ('dipole_interaction',)
    needs_position = True

    length: float = parameter('length_um', 'ℓ', -1e-4, 1e-4, 1e-6)

    def speed_factor(self, context: EffectContext) -> np.ndarray:
        return np.maximum(1 - self.length * context.known_places.nearness, 0.0)

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.has_neighbours
