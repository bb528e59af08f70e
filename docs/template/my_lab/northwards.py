"""The simplest controller that looks at something."""

from dataclasses import dataclass

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Input,
    NotLearnedError,
    Progress,
)
from microbot_ros.control.steering.courses import field_along


@dataclass(frozen=True)
class NorthwardsParameters:
    """On the controller node they are `northwards.particle` and `northwards.field_mT`."""

    particle: int = setting(0, 'Particle to send north.', lower=0, upper=2**31 - 1)
    field_mT: float = setting(3.0, 'Strength of the field.', lower=0.0, upper=100.0)


class Northwards(Controller):
    """Turns the field so that one particle swims north."""

    interface_version = 1
    summary = 'Sends one particle north.'
    takes = frozenset[Input]()  # no goals, paths, plans or joystick: they are refused
    Parameters = NorthwardsParameters

    def activate(self, inputs: ControllerInput) -> None:
        """Refuses the switch where the particle is not seen."""
        inputs.index(self.parameters.particle)

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """The field at −φ from north: a particle swims at φ from the field."""
        row = inputs.index(self.parameters.particle)
        if not np.isfinite(inputs.phi[row]):
            raise NotLearnedError('waits until φ is known')  # "not now": asked again next tick
        strength = units.to_si('field_mT', self.parameters.field_mT)
        field = field_along(inputs, np.pi / 2 - inputs.phi[row], strength)
        to_go = inputs.workspace.high[1] - inputs.position[row, 1]
        return FieldCommand(field, progress=Progress('goes north', False, to_go),
                            particles=inputs.ids[row:row + 1])
