"""Delay between command and field."""

from __future__ import annotations

from dataclasses import dataclass

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.parameter import STAMPS, parameter


@dataclass(frozen=True)
class CommandDelay(Effect):
    """B(t) = B_cmd(t − δ)."""

    id = 'command_delay'
    stage = 'field'
    summary = 'The field follows the command with a fixed delay.'
    required_excitation = (
        'turns of the command by different angles, or of its strength or frequency')
    confounded_with = ('alignment_lag', 'heading_slip')

    delay: float = parameter('delay_s', 'from command to field', 0.0, 2.0, 0.05,
                             floor=STAMPS)

    def latency(self) -> float:
        return self.delay

    @classmethod
    def absorbed_by_phi(cls, evidence: Evidence) -> bool:
        """Return whether φ absorbs it, as for a command that turns in one sense only."""
        return evidence.absorbs(cls(delay=5e-4))
