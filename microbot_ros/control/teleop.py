"""A person steers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from microbot_ros import units
from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    NotLearnedError,
    Progress,
    Situation,
    no_field,
)
from microbot_ros.control.steering import field_along
from microbot_ros.settings import setting


@dataclass(frozen=True)
class TeleopParameters:
    """What the stick moves."""

    particle: int = setting(
        -1, 'Particle that goes where the stick points; -1 lets the field point there.',
        lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    frequency_hz: float = setting(
        0.0, 'Rotation frequency for rollers at full deflection.', lower=0.0, upper=1000.0)
    dead_zone: float = setting(
        0.15, 'Deflection that counts as none, of 1.', lower=0.0, upper=0.9)


class Teleop(Controller):
    """The field, or the particle chosen, follows the joystick; without deflection no field."""

    interface_version = 1
    summary = 'By joystick.'
    Parameters = TeleopParameters

    def activate(self, situation: Situation) -> None:
        """ParticleLostError where the particle asked for is not seen."""
        if self.parameters.particle >= 0:
            situation.index(self.parameters.particle)

    def compute(self, situation: Situation) -> FieldCommand:
        """The field that the stick asks for."""
        p = self.parameters
        deflection = min(math.hypot(*situation.joystick), 1.0)
        if not deflection > p.dead_zone:
            return no_field('the stick is at rest')
        angle = math.atan2(situation.joystick[1], situation.joystick[0])
        particles = None
        if p.particle >= 0:
            row = situation.index(p.particle)
            if not math.isfinite(situation.phi[row]):
                raise NotLearnedError(f'how particle {p.particle} answers is not known yet')
            angle -= float(situation.phi[row])
            particles = situation.ids[row:row + 1]
        strength = units.to_si('field_mT', p.field_mT)
        pace = (deflection - p.dead_zone) / (1 - p.dead_zone)
        frequency = min(p.frequency_hz * pace, situation.limits.frequency)
        progress = Progress(f'steered to {math.degrees(angle):.0f}°')
        return FieldCommand(field_along(situation, angle, strength), frequency, progress,
                            particles)
