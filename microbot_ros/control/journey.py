"""What the controllers of one particle with goals have in common."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from microbot_ros import units
from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    Progress,
    Situation,
    no_field,
)
from microbot_ros.control.itinerary import Itinerary
from microbot_ros.control.pilot import Pilot
from microbot_ros.control.steering import Excitation
from microbot_ros.settings import setting


@dataclass(frozen=True)
class JourneyParameters:
    """Whom to drive, and how closely."""

    particle: int = setting(
        -1, 'Identity of the particle to drive; -1 takes the one nearest to the first goal.',
        lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    arrival_um: float = setting(
        2.0, 'A goal counts as reached from this close.', lower=0.05, upper=1000.0)
    learn_leg_s: float = setting(
        1.0, 'Until it is known how the particle answers: time on each side of a triangle.',
        lower=0.1, upper=60.0)


class Journey(Controller):
    """One particle through the goals in order; a new list starts from its first, an empty one
    cancels. Until the particle's answer to the field is known, the field goes round a triangle.
    """

    Parameters = JourneyParameters
    rolling: ClassVar[bool] = False

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget the goals, how far they were done, whom it drove and what was learned of it."""
        self._itinerary = Itinerary()
        self._excitation = Excitation()
        self._pilot = Pilot(self.rolling)

    def activate(self, situation: Situation) -> None:
        """ParticleLostError where the particle asked for is not seen."""
        self._excitation.stop()
        if self.parameters.particle >= 0:
            situation.index(self.parameters.particle)

    def compute(self, situation: Situation) -> FieldCommand:
        """Towards the next goal, or what is done at the last, or the triangle."""
        p: Any = self.parameters
        itinerary, pilot = self._itinerary, self._pilot
        itinerary.update(situation, p.particle)
        if not len(itinerary):
            return no_field('waits for a goal')
        row = itinerary.row(situation)
        place = pilot.look(situation, row)
        particles = situation.ids[row:row + 1]
        strength = units.to_si('field_mT', p.field_mT)
        if not pilot.ready:
            return self._excitation.command(
                situation, p.learn_leg_s, strength, particles=particles,
                frequency=self.fastest(situation))
        self._excitation.stop()
        offset = itinerary.offset(place, units.to_si('arrival_um', p.arrival_um))
        message = f'{itinerary}, {abs(offset) * 1e6:.1f} µm'
        return dataclasses.replace(
            self.drive(situation, offset, strength),
            progress=Progress(message, itinerary.done, abs(offset)),
            particles=particles)

    def fastest(self, situation: Situation) -> float:
        """The highest frequency [Hz] it uses."""
        return 0.0

    @abstractmethod
    def drive(self, situation: Situation, offset: complex, strength: float) -> FieldCommand:
        """With a field of `strength` [T] to the present goal, `offset` [m] away."""
