"""Steering by joystick."""

from __future__ import annotations

import math
from dataclasses import dataclass

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Input,
    NotLearnedError,
    Progress,
    no_field,
)
from microbot_ros.control.steering.courses import field_along


@dataclass(frozen=True)
class TeleopParameters:
    """What the joystick moves."""

    particle: int = setting(
        -1, 'Particle that moves where the stick points; -1: the field points there.',
        lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    frequency_hz: float = setting(
        0.0, 'Rotation frequency for rollers at full deflection.', lower=0.0, upper=1000.0)
    dead_zone: float = setting(
        0.15, 'Deflection (0 to 1) below which the stick counts as centred.', lower=0.0, upper=0.9)


class Teleop(Controller):
    """The field, or the selected particle, follows the joystick; no field without deflection."""

    interface_version = 1
    summary = 'By joystick.'
    takes = frozenset({Input.JOYSTICK})
    Parameters = TeleopParameters

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ParticleLostError if the selected particle is not in `inputs`."""
        if self.parameters.particle >= 0:
            inputs.index(self.parameters.particle)

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the field for the joystick of `inputs`."""
        p = self.parameters
        deflection = min(math.hypot(*inputs.joystick), 1.0)
        if not deflection > p.dead_zone:
            return no_field('the stick is centred')
        angle = math.atan2(inputs.joystick[1], inputs.joystick[0])
        particles = None
        if p.particle >= 0:
            row = inputs.index(p.particle)
            if not math.isfinite(inputs.phi[row]):
                raise NotLearnedError(f'v and φ of particle {p.particle} are not known yet')
            angle -= float(inputs.phi[row])
            particles = inputs.ids[row:row + 1]
        strength = units.to_si('field_mT', p.field_mT)
        pace = (deflection - p.dead_zone) / (1 - p.dead_zone)
        frequency = min(p.frequency_hz * pace, inputs.limits.frequency)
        progress = Progress(f'steered to {math.degrees(angle):.0f}°')
        return FieldCommand(field_along(inputs, angle, strength), frequency, progress,
                            particles)
