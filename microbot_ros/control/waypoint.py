"""Sends one particle to a goal or through a list of them, and keeps it at the last."""

from __future__ import annotations

from dataclasses import dataclass

from microbot_ros import units
from microbot_ros.control.contract import FieldCommand, Situation
from microbot_ros.control.journey import Journey, JourneyParameters
from microbot_ros.control.steering import approach
from microbot_ros.settings import setting


@dataclass(frozen=True)
class WaypointParameters(JourneyParameters):
    """Whom to drive, and how closely."""

    hold_radius_um: float = setting(
        1.0, 'Radius of the circle around the last goal.', lower=0.1, upper=100.0)


class Waypoint(Journey):
    """Straight to each goal, crabbed against the drift; round the last it circles, because it
    can't stop.
    """

    interface_version = 1
    summary = 'One particle to a goal or through a list.'
    Parameters = WaypointParameters

    def drive(self, situation: Situation, offset: complex, strength: float) -> FieldCommand:
        """Along the tangent to the circle round the goal."""
        course = approach(offset, units.to_si('hold_radius_um', self.parameters.hold_radius_um))
        return FieldCommand(self._pilot.steer(situation, course, strength))
