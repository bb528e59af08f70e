"""Incomplete alignment of moments in a weak field by thermal motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class IncompleteAlignment(Effect):
    """v → v L(|B|/b₀), L(x) = coth x − 1/x, B the field after stage 1.

    Langevin’s function is the mean alignment of moments at thermal equilibrium in three
    dimensions. At b₀ = k_B T / d the magnetic and the thermal energy are equal.
    """

    id = 'incomplete_alignment'
    stage = 'velocity'
    summary = 'The particles are slower in weak fields, which align them incompletely.'
    required_excitation = 'several field strengths; at one alone the speeds absorb it'
    confounded_with = ('amplifier_deadband', 'drive_response', 'speed_decay', 'coil_pull')

    field_scale: float = parameter('field_scale_mT', 'k_B T / moment', 0.0, 1e-1, 1e-3)

    def speed_factor(self, context: EffectContext) -> np.ndarray | float:
        if self.field_scale == 0:
            return 1.0
        return langevin_function(context.strength / self.field_scale)

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.strength_known


def langevin_function(x: np.ndarray) -> np.ndarray:
    """Return Langevin's function L(x) = coth x − 1/x.

    Near zero it uses the series x/3 − x³/45, since the difference cancels there.

    Parameters
    ----------
    x : ndarray
        Argument.

    Returns
    -------
    ndarray
        L(x).
    """
    small = np.abs(x) < 1e-2
    large = np.where(small, 1.0, x)
    return np.where(small, x / 3 - x**3 / 45, 1 / np.tanh(large) - 1 / large)
