"""Drive all particles towards their goals, as near as one field allows.

`SharedField` is the base of controllers of many particles; `Ensemble` adds goals.
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
    """Field strength, learning and margins."""

    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    hold_radius_um: float = setting(
        1.0, 'Radius of the circles on which particles wait at the end.', lower=0.1, upper=100.0)
    margin_um: float = setting(
        5.0, 'Distance that particles keep from the edge of the '
             'workspace.', lower=0.0, upper=1000.0)
    learn_phi_std_rad: float = setting(
        0.2, 'Uncertainty of φ below which a particle takes part.', lower=0.01, upper=1.5)
    learn_leg_s: float = setting(
        1.0, 'Time on each side of the triangle that is driven until the first particle takes '
             'part.',
        lower=0.1, upper=60.0)


@dataclass(frozen=True)
class Aim:
    """Target of one tick: `displacement` U [s] is the best for what is `wanted` (K,) [m].

    `answer` (K,) [m/s] are the velocity phasors c of the particles.
    """

    displacement: complex
    wanted: np.ndarray
    answer: np.ndarray

    @classmethod
    def least_squares(cls, answer: np.ndarray, wanted: np.ndarray) -> Aim:
        """Return the aim with the smallest sum of squares, for `answer` and `wanted` (K,).

        Parameters
        ----------
        answer : ndarray, shape (K,)
            Responses, complex.
        wanted : ndarray, shape (K,)
            Wanted displacements, complex.

        Returns
        -------
        Aim
            The aim.
        """
        return cls(best_displacement(answer, wanted), wanted, answer)

    @property
    def distance(self) -> float:
        """RMS of the wanted displacements [m]."""
        return float(np.sqrt(np.mean(np.abs(self.wanted) ** 2)))

    @property
    def floor(self) -> float:
        """RMS of what remains after the displacement [m]."""
        left = self.wanted - self.answer * self.displacement
        return float(np.sqrt(np.mean(np.abs(left) ** 2)))


class SharedField(Controller):
    """Drives all particles along one shared displacement U, recomputed at each tick.

    U is limited such that every particle stays in view; at its end all particles circle. Until φ
    of any particle is known, the field runs through a triangle.
    """

    Parameters = SharedFieldParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget the request."""
        self._excitation = Excitation()

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ModelError if `inputs` are of rollers, for which there are better controllers."""
        self._excitation.stop()
        inputs.refuse_rollers()

    @abstractmethod
    def involved(self, inputs: ControllerInput) -> np.ndarray:
        """Return the rows (K,) in `inputs` of driven particles; none: the field is off.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        ndarray, shape (K,)
            Rows.
        """

    @abstractmethod
    def aim(self, inputs: ControllerInput, rows: np.ndarray, velocity: np.ndarray) -> Aim:
        """Return the aim for `rows` of `inputs` with known `velocity` v e^{iφ} (K,) [m/s].

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        rows : ndarray, shape (K,)
            Rows of the particles.
        velocity : ndarray, shape (K,)
            Velocity phasors [m/s].

        Returns
        -------
        Aim
            The aim.
        """

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return for `inputs` a field along U, or the circle at its end."""
        p: Any = self.parameters
        rows = self.involved(inputs)
        if not len(rows):
            return no_field('waiting for goals')
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

    The final error is the floor: no controller gets below it under the first-order model.
    """

    interface_version = 1
    summary = 'Bring all particles as near to their goals as one field allows.'
    takes = ANY_GOALS

    def reset(self) -> None:
        """Forget the goals."""
        super().reset()
        self._assignment = Assignment()

    def involved(self, inputs: ControllerInput) -> np.ndarray:
        """Return the rows of `inputs` that have goals."""
        self._assignment.update(inputs)
        return self._assignment.pairs(inputs)[0]

    def aim(self, inputs: ControllerInput, rows: np.ndarray, velocity: np.ndarray) -> Aim:
        """Return the aim of `rows` of `inputs` for their goals, by their `velocity`."""
        all_rows, goals = self._assignment.pairs(inputs)
        mine = goals[np.isin(all_rows, rows)]
        return Aim.least_squares(velocity, as_complex(mine - inputs.expected[rows]))
