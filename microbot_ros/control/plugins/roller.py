"""Drive a rolling particle, whose speed follows the frequency of the field: it can stop."""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from typing import Any

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    ANY_GOALS,
    ControllerInput,
    FieldCommand,
    no_field,
)
from microbot_ros.control.steering.courses import field_along
from microbot_ros.control.steering.goal_controller_base import (
    GoalControllerBase,
    GoalControllerParameters,
)


@dataclass(frozen=True)
class RollerParameters(GoalControllerParameters):
    """The particle, its speed and accuracy."""

    arrival_um: float = setting(
        0.5, 'Distance below which a goal counts as reached.', lower=0.05, upper=1000.0)
    slowest_hz: float = setting(
        0.5, 'Lowest frequency used; below it particles roll unevenly.', lower=0.0, upper=1000.0)
    fastest_hz: float = setting(
        5.0, 'Highest frequency used, below the step-out.', lower=0.01, upper=1000.0)
    braking_s: float = setting(
        0.5, 'Time constant with which a goal is approached.', lower=0.02, upper=60.0)


class Roller(GoalControllerBase):
    """Drives one roller through the goals in order; it rests at the last.

    dp/dt = g f R(φ) u + w with the gain g [m/s/Hz] and a drift w. The frequency f follows the
    distance, within the range in which particles roll evenly.
    """

    interface_version = 1
    summary = 'Drive one rolling particle to a goal or through a list of goals.'
    takes = ANY_GOALS
    Parameters = RollerParameters
    rolling = True

    def configure(self, parameters: Any) -> None:
        """Take `parameters`; ValueError if the slowest frequency is above the fastest."""
        if not parameters.slowest_hz <= parameters.fastest_hz:
            raise ValueError(f'slowest_hz must be at most fastest_hz; received '
                             f'{parameters.slowest_hz:g} and {parameters.fastest_hz:g}')
        super().configure(parameters)

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ModelError for `inputs` without a model of rollers."""
        super().activate(inputs)
        inputs.require_rollers()

    def fastest(self, inputs: ControllerInput) -> float:
        """Return the highest frequency [Hz] for `inputs`."""
        return min(self.parameters.fastest_hz, inputs.limits.frequency)

    def drive(self, inputs: ControllerInput, offset: complex, strength: float) -> FieldCommand:
        """Return a field of `strength` [T] for `inputs`, slower the smaller the `offset` [m]."""
        p, compensator = self.parameters, self._compensator
        if abs(offset) <= units.to_si('arrival_um', p.arrival_um):
            return no_field('')
        wanted = (offset / p.braking_s - compensator.drift) / compensator.answer
        fastest = self.fastest(inputs)
        frequency = min(max(abs(wanted), p.slowest_hz), fastest)
        return FieldCommand(field_along(inputs, cmath.phase(wanted), strength), frequency)
