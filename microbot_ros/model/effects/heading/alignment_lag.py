"""Alignment of the heading with the field at a finite rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import STAMPS, parameter


@dataclass(frozen=True)
class AlignmentLag(Effect):
    """dθ/dt = (|B|/B_ref)/τ · sin(θ_B + φ − θ), B the field after stage 1.

    The overdamped balance of magnetic torque d·B and rotational drag 8πηr³: at the reference field
    τ = 8πηr³/(d·B_ref). τ = 0 is immediate alignment.
    """

    id = 'alignment_lag'
    stage = 'heading'
    summary = 'The heading needs time to turn into the field, longer in a weaker one.'
    required_excitation = (
        'turns of the command by different angles, best some near 180° and some near 30°')
    confounded_with = ('command_delay', 'heading_slip')

    tau: float = parameter('tau_s', 'alignment time at the reference field', 0.0, 30.0, 0.1,
                           floor=STAMPS)

    def alignment_rate(self, context: EffectContext) -> np.ndarray | None:
        if self.tau == 0:
            return None
        return context.strength / (context.reference_field * self.tau)

    @classmethod
    def absorbed_by_phi(cls, evidence: Evidence) -> bool:
        """Return whether φ absorbs it, as for a command that turns in one sense only."""
        return evidence.absorbs(cls(tau=1e-3))
