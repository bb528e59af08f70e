"""Field set by hand, in three axes: static or rotating about an axis."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Input,
    Progress,
)


@dataclass(frozen=True)
class ManualParameters:
    """The field by the angles customary in laboratories: α, γ, ψ and f."""

    field_mT: float = setting(0.0, 'Strength of the field.', lower=0.0, upper=100.0)
    alpha_deg: float = setting(
        0.0, 'Azimuth α of the axis, from x.', lower=-360.0, upper=360.0)
    gamma_deg: float = setting(
        90.0, 'Angle γ between the axis and z: 90 lies in the plane.', lower=0.0, upper=180.0)
    psi_deg: float = setting(
        90.0, 'Half the angle ψ of the cone on which a field goes round the axis: 90 is a disc.',
        lower=0.0, upper=90.0)
    frequency_hz: float = setting(
        0.0, 'Rotation frequency, right-handed; at 0 the field is static along the axis.',
        lower=0.0, upper=1000.0)


class Manual(Controller):
    """Static field along an axis, or field that rotates on a cone of ψ about it.

    B = |B| (sin γ cos α, sin γ sin α, cos γ). No goals are followed and no particles kept in view.
    Rollers move towards α − 90°.
    """

    interface_version = 1
    summary = 'Apply a field set by hand, static or rotating, in three axes.'
    takes = frozenset[Input]()
    Parameters = ManualParameters

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the field of the parameters, within the limits of `inputs`."""
        p = self.parameters
        strength = min(units.to_si('field_mT', p.field_mT), inputs.limits.field)
        frequency = min(p.frequency_hz, inputs.limits.frequency)
        alpha, gamma = math.radians(p.alpha_deg), math.radians(p.gamma_deg)
        axis = np.array([math.sin(gamma) * math.cos(alpha), math.sin(gamma) * math.sin(alpha),
                         math.cos(gamma)])
        if not frequency:
            return FieldCommand(strength * axis, progress=Progress('the field is static'))
        psi = math.radians(p.psi_deg)
        across = np.array([-math.sin(alpha), math.cos(alpha), 0.0])
        field = strength * (math.cos(psi) * axis + math.sin(psi) * across)
        return FieldCommand(field, frequency, Progress(f'the field rotates at {frequency:g} Hz'),
                            axis=axis)
