"""Sends one particle to a goal or through a list of them, and keeps it at the last."""

from __future__ import annotations

from dataclasses import dataclass

from microbot_ros import units
from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    Progress,
    Situation,
    no_field,
)
from microbot_ros.control.itinerary import Itinerary
from microbot_ros.control.steering import Excitation, approach, field_along
from microbot_ros.settings import setting


@dataclass(frozen=True)
class WaypointParameters:
    """Whom to drive, and how closely."""

    particle: int = setting(
        -1, 'Identity of the particle to drive; -1 takes the one nearest to the first goal.',
        lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    arrival_um: float = setting(
        2.0, 'A goal counts as reached from this close.', lower=0.1, upper=1000.0)
    hold_radius_um: float = setting(
        1.0, 'Radius of the circle around the last goal.', lower=0.1, upper=100.0)
    learn_phi_std_rad: float = setting(
        0.2, 'The goal is headed for once φ is known this well.', lower=0.01, upper=1.5)
    learn_leg_s: float = setting(
        1.0, 'Until then: time on each side of a triangle.', lower=0.1, upper=60.0)


class Waypoint(Controller):
    """One particle through the goals in order; around the last it circles, for it can't stop.

    A new list of goals starts from its first; an empty one cancels.
    """

    interface_version = 1
    summary = 'One particle to a goal or through a list.'
    Parameters = WaypointParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget the goals, how far they were done, and whom it drove."""
        self._itinerary = Itinerary()
        self._excitation = Excitation()

    def activate(self, situation: Situation) -> None:
        """ParticleLostError where the particle asked for is not seen."""
        self._excitation.stop()
        if self.parameters.particle >= 0:
            situation.index(self.parameters.particle)

    def compute(self, situation: Situation) -> FieldCommand:
        """Towards the next goal, or around the last, or a triangle while φ is unknown."""
        p, itinerary = self.parameters, self._itinerary
        itinerary.update(situation, p.particle)
        if not len(itinerary):
            return no_field('waits for a goal')
        row = itinerary.row(situation)
        strength = units.to_si('field_mT', p.field_mT)
        if not situation.learned(p.learn_phi_std_rad)[row]:
            return self._excitation.command(situation, p.learn_leg_s, strength)
        self._excitation.stop()
        offset = itinerary.offset(situation.expected[row], units.to_si('arrival_um', p.arrival_um))
        course = approach(offset, units.to_si('hold_radius_um', p.hold_radius_um))
        field = field_along(situation, course - situation.phi[row], strength)
        message = f'{itinerary}, {abs(offset) * 1e6:.1f} µm'
        return FieldCommand(field, progress=Progress(message, itinerary.done, abs(offset)))
