"""Send one particle to a goal or through a list, and keep it at the last."""

from __future__ import annotations

from dataclasses import dataclass

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import ANY_GOALS, ControllerInput, FieldCommand
from microbot_ros.control.steering.courses import approach
from microbot_ros.control.steering.goal_controller_base import (
    GoalControllerBase,
    GoalControllerParameters,
)


@dataclass(frozen=True)
class WaypointParameters(GoalControllerParameters):
    """The particle, and how closely it holds."""

    hold_radius_um: float = setting(
        1.0, 'Radius of the circle around the last goal.', lower=0.1, upper=100.0)


class Waypoint(GoalControllerBase):
    """Drives straight to each goal, with the drift compensated, and circles the last.

    A swimming particle cannot stop.
    """

    interface_version = 1
    summary = 'Drive one particle to a goal or through a list of goals.'
    takes = ANY_GOALS
    Parameters = WaypointParameters

    def drive(self, inputs: ControllerInput, offset: complex, strength: float) -> FieldCommand:
        """Return a field of `strength` [T] for `inputs`, tangential to the `offset` [m]."""
        course = approach(offset, units.to_si('hold_radius_um', self.parameters.hold_radius_um))
        return FieldCommand(self._compensator.steer(inputs, course, strength))
