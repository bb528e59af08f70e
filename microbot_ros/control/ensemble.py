"""All particles towards their goals at once, as near as one field can bring them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros import units
from microbot_ros.control.assignment import Assignment
from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    ModelError,
    Progress,
    Situation,
    no_field,
)
from microbot_ros.control.shared import (
    as_complex,
    best_displacement,
    borders,
    floor,
    nearest_allowed,
)
from microbot_ros.control.steering import Excitation, approach, field_along
from microbot_ros.settings import setting


@dataclass(frozen=True)
class EnsembleParameters:
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


class Ensemble(Controller):
    """Least squares over all particles and goals, in closed form, anew at each tick.

    The displacement U* that all share is kept within what holds every particle in view. What is
    left then is the floor: no controller gets below it under the first-order model.
    """

    interface_version = 1
    summary = 'All particles as near to their goals as one field allows.'
    Parameters = EnsembleParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget the goals."""
        self._assignment = Assignment()
        self._excitation = Excitation()

    def activate(self, situation: Situation) -> None:
        """ModelError for rollers: they stop, so the `roller` controller serves them better."""
        self._excitation.stop()
        if situation.model is not None and situation.model.propulsion == 'rolling':
            raise ModelError('drives particles that propel themselves; the model is of rollers')

    def compute(self, situation: Situation) -> FieldCommand:
        """Along U*, and round it once it is reached."""
        self._assignment.update(situation)
        rows, goals = self._assignment.pairs(situation)
        if not len(rows):
            return no_field('waits for goals')
        strength = units.to_si('field_mT', self.parameters.field_mT)
        known = situation.learned(self.parameters.learn_phi_std_rad)[rows]
        known &= situation.speed[rows] > 0
        if not known.any():
            leg = self.parameters.learn_leg_s
            return self._excitation.command(situation, leg, strength)
        rows, goals = rows[known], goals[known]
        velocity = situation.speed[rows] * np.exp(1j * situation.phi[rows])
        wanted = as_complex(goals - situation.expected[rows])
        shared = self._shared(situation, rows, velocity, wanted)
        radius = units.to_si('hold_radius_um', self.parameters.hold_radius_um)
        hold = radius / float(np.abs(velocity).max())
        field = field_along(situation, approach(shared, hold), strength)
        return FieldCommand(field, progress=_progress(velocity, wanted, shared, hold))

    def _shared(self, situation: Situation, rows: np.ndarray, velocity: np.ndarray,
                wanted: np.ndarray) -> complex:
        margin = units.to_si('margin_um', self.parameters.margin_um)
        normal, room = borders(situation.workspace, situation.expected[rows], velocity, margin)
        return nearest_allowed(best_displacement(velocity, wanted), normal, room)


def _progress(velocity: np.ndarray, wanted: np.ndarray, shared: complex,
              hold: float) -> Progress:
    distance = float(np.sqrt(np.mean(np.abs(wanted) ** 2)))
    reachable = floor(velocity, wanted)
    message = (f'{len(wanted)} particles {distance * 1e6:.1f} µm from their goals, '
               f'{reachable * 1e6:.1f} µm at best')
    return Progress(message, abs(shared) <= 2 * hold, distance)
