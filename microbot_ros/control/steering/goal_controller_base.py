"""Base of controllers that drive one particle to goals."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Progress,
    no_field,
)
from microbot_ros.control.steering.courses import Excitation
from microbot_ros.control.steering.drift_compensator import DriftCompensator
from microbot_ros.control.steering.goal_sequence import GoalSequence


@dataclass(frozen=True)
class GoalControllerParameters:
    """The particle, and how closely it reaches goals."""

    particle: int = setting(
        -1, 'Identity of the particle to drive; -1 takes the one nearest to the first goal.',
        lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    arrival_um: float = setting(
        2.0, 'Distance below which a goal counts as reached.', lower=0.05, upper=1000.0)
    learn_leg_s: float = setting(
        1.0, 'Time on each side of the triangle that is driven until v and φ of the particle are '
             'known.',
        lower=0.1, upper=60.0)


class GoalControllerBase(Controller):
    """Drives one particle through the goals in order.

    A new list starts from its first goal, an empty one cancels. Until the particle's response to
    the field is known, the field runs through a triangle.
    """

    Parameters = GoalControllerParameters
    rolling: ClassVar[bool] = False

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget goals, progress, the particle and what was learned about it."""
        self._sequence = GoalSequence()
        self._excitation = Excitation()
        self._compensator = DriftCompensator(self.rolling)

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ParticleLostError if the selected particle is not in `inputs`."""
        self._excitation.stop()
        if self.parameters.particle >= 0:
            inputs.index(self.parameters.particle)

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return a field for `inputs`: to the goal, at the last goal, or a triangle."""
        p: Any = self.parameters
        sequence, compensator = self._sequence, self._compensator
        sequence.update(inputs, p.particle)
        if not len(sequence):
            return no_field('waits for a goal')
        row = sequence.row(inputs)
        place = compensator.look(inputs, row)
        particles = inputs.ids[row:row + 1]
        strength = units.to_si('field_mT', p.field_mT)
        if not compensator.ready:
            return self._excitation.command(
                inputs, p.learn_leg_s, strength, particles=particles,
                frequency=self.fastest(inputs))
        self._excitation.stop()
        offset = sequence.offset(place, units.to_si('arrival_um', p.arrival_um))
        message = f'{sequence}, {abs(offset) * 1e6:.1f} µm'
        return dataclasses.replace(
            self.drive(inputs, offset, strength),
            progress=Progress(message, sequence.done, abs(offset), sequence.present),
            particles=particles)

    def fastest(self, inputs: ControllerInput) -> float:
        """Return the highest frequency [Hz] for `inputs`.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        float
            Frequency [Hz].
        """
        return 0.0

    @abstractmethod
    def drive(self, inputs: ControllerInput, offset: complex, strength: float) -> FieldCommand:
        """Return a field of `strength` [T] for `inputs` to the goal at `offset` [m].

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        offset : complex
            Vector to the goal, complex [m].
        strength : float
            Strength of the field [T].

        Returns
        -------
        FieldCommand
            The command.
        """
