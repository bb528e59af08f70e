"""All particles towards their goals at once, as near as one field can bring them.

What the controllers of many particles have in common is `SharedField`; `Ensemble` adds goals.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    ANY_GOALS,
    Controller,
    ControllerInput,
    FieldCommand,
    ModelError,
    Progress,
    no_field,
)
from microbot_ros.control.planning.assignment import Assignment
from microbot_ros.control.planning.shared import (
    as_complex,
    best_displacement,
    borders,
    nearest_allowed,
)
from microbot_ros.control.steering.courses import Excitation, approach, field_along


@dataclass(frozen=True)
class SharedFieldParameters:
    """Strength, patience and margins."""

    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    hold_radius_um: float = setting(
        1.0, 'Radius of the circles in which particles wait at the end.', lower=0.1, upper=100.0)
    margin_um: float = setting(
        5.0, 'Particles are kept this far inside the workspace.', lower=0.0, upper=1000.0)
    learn_phi_std_rad: float = setting(
        0.2, 'Particles take part once φ is known this well.', lower=0.01, upper=1.5)
    learn_leg_s: float = setting(
        1.0, 'Until the first takes part: time on each side of a triangle.',
        lower=0.1, upper=60.0)


@dataclass(frozen=True)
class Aim:
    """What to make of particles: `displacement` U [s] is best for the `wanted` (K,) [m] of each,
    their `answer` c (K,) [m/s] being counted in the same way."""

    displacement: complex
    wanted: np.ndarray
    answer: np.ndarray

    @classmethod
    def least_squares(cls, answer: np.ndarray, wanted: np.ndarray) -> Aim:
        """The displacement that leaves the smallest sum of squares."""
        return cls(best_displacement(answer, wanted), wanted, answer)

    @property
    def distance(self) -> float:
        """RMS of what is wanted [m]."""
        return float(np.sqrt(np.mean(np.abs(self.wanted) ** 2)))

    @property
    def floor(self) -> float:
        """RMS of what is left after the displacement [m]."""
        left = self.wanted - self.answer * self.displacement
        return float(np.sqrt(np.mean(np.abs(left) ** 2)))


class SharedField(Controller):
    """Drives all particles along one shared displacement U, worked out anew at each tick.

    U is kept within what holds every particle in view; round the end of it all circle. Until φ
    of any is known, the field goes round a triangle.
    """

    Parameters = SharedFieldParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget what was asked for."""
        self._excitation = Excitation()

    def activate(self, inputs: ControllerInput) -> None:
        """ModelError for `inputs` of rollers: one of those can be stopped, which serves it better.
        """
        self._excitation.stop()
        if inputs.model is not None and inputs.model.propulsion == 'rolling':
            raise ModelError('drives particles that propel themselves; the model is of rollers')

    @abstractmethod
    def involved(self, inputs: ControllerInput) -> np.ndarray:
        """Rows (K,) in `inputs` of particles that something is asked of; none: the field is off.
        """

    @abstractmethod
    def aim(self, inputs: ControllerInput, rows: np.ndarray, velocity: np.ndarray) -> Aim:
        """What to do with `rows` of `inputs`, whose `velocity` v e^{iφ} (K,) is known."""

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """For `inputs` along U, and round it once it is reached."""
        p: Any = self.parameters
        rows = self.involved(inputs)
        if not len(rows):
            return no_field('waits for goals')
        strength = units.to_si('field_mT', p.field_mT)
        known = inputs.learned(p.learn_phi_std_rad)[rows] & (inputs.speed[rows] > 0)
        if not known.any():
            return self._excitation.command(
                inputs, p.learn_leg_s, strength, particles=inputs.ids[rows])
        rows = rows[known]
        velocity = inputs.speed[rows] * np.exp(1j * inputs.phi[rows])
        aim = self.aim(inputs, rows, velocity)
        margin = units.to_si('margin_um', p.margin_um)
        normal, room = borders(inputs.workspace, inputs.expected[rows], velocity, margin)
        shared = nearest_allowed(aim.displacement, normal, room)
        hold = units.to_si('hold_radius_um', p.hold_radius_um) / float(np.abs(velocity).max())
        message = (f'{len(rows)} particles {aim.distance * 1e6:.1f} µm from their goals, '
                   f'{aim.floor * 1e6:.1f} µm at best')
        progress = Progress(message, abs(shared) <= 2 * hold, aim.distance)
        return FieldCommand(field_along(inputs, approach(shared, hold), strength),
                            progress=progress, particles=inputs.ids[rows])


class Ensemble(SharedField):
    """Least squares over all particles and goals, in closed form.

    What is left in the end is the floor: no controller gets below it under the first-order model.
    """

    interface_version = 1
    summary = 'All particles as near to their goals as one field allows.'
    takes = ANY_GOALS

    def reset(self) -> None:
        """Forget the goals."""
        super().reset()
        self._assignment = Assignment()

    def involved(self, inputs: ControllerInput) -> np.ndarray:
        """The rows of `inputs` that have goals."""
        self._assignment.update(inputs)
        return self._assignment.pairs(inputs)[0]

    def aim(self, inputs: ControllerInput, rows: np.ndarray, velocity: np.ndarray) -> Aim:
        """Each of `rows` of `inputs` to its goal, by its `velocity`."""
        all_rows, goals = self._assignment.pairs(inputs)
        mine = goals[np.isin(all_rows, rows)]
        return Aim.least_squares(velocity, as_complex(mine - inputs.expected[rows]))
