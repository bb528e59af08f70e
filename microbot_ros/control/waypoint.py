"""Sends one particle to a goal or through a list of them, and keeps it at the last."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros import units
from microbot_ros.control.contract import (
    NO_PLACES,
    Controller,
    FieldCommand,
    ParticleLostError,
    Progress,
    Situation,
    no_field,
)
from microbot_ros.control.steering import approach, excitation, field_along, goals_in_reach
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

    Goals that name particles are taken for the particle they name first, or for the one that
    is driven. A new list of goals starts from its first; an empty one cancels.
    """

    interface_version = 1
    summary = 'One particle to a goal or through a list.'
    Parameters = WaypointParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget the goals, how far they were done, and whom it drove."""
        self._goals = NO_PLACES
        self._next = 0
        self._done = False
        self._particle = -1
        self._learning_since: float | None = None

    def activate(self, situation: Situation) -> None:
        """ParticleLostError where the particle asked for by name is not seen."""
        self._learning_since = None
        if self.parameters.particle >= 0:
            situation.index(self.parameters.particle)

    def compute(self, situation: Situation) -> FieldCommand:
        """Towards the next goal, or around the last, or a triangle while φ is unknown."""
        self._take_goals(situation)
        if not len(self._goals):
            return no_field('waits for a goal')
        row = situation.index(self._choose(situation))
        strength = units.to_si('field_mT', self.parameters.field_mT)
        if not situation.learned(self.parameters.learn_phi_std_rad)[row]:
            return self._learn(situation, strength)
        self._learning_since = None
        offset = self._advance(situation.expected[row])
        radius = units.to_si('radius_um', self.parameters.hold_radius_um)
        course = approach(offset, radius)
        field = field_along(situation, course - situation.phi[row], strength)
        message = (f'particle {self._particle}: goal {self._next + 1} of {len(self._goals)}, '
                   f'{abs(offset) * 1e6:.1f} µm')
        return FieldCommand(field, progress=Progress(message, self._done, abs(offset)))

    def _take_goals(self, situation: Situation) -> None:
        position, ids = goals_in_reach(situation), situation.goals.ids
        if ids is not None and len(ids):
            wanted = self.parameters.particle if self.parameters.particle >= 0 else ids[0]
            position = position[ids == wanted]
        if not np.array_equal(position, self._goals):
            self._goals, self._next, self._done = position, 0, False
            self._particle = -1 if ids is None or not len(ids) else int(wanted)

    def _choose(self, situation: Situation) -> int:
        if self.parameters.particle >= 0:
            self._particle = self.parameters.particle
        elif self._particle not in situation.ids:
            if not len(situation.ids):
                raise ParticleLostError('no particle is seen')
            if self._particle >= 0 and situation.goals.ids is not None:
                raise ParticleLostError(f'particle {self._particle} is not seen')
            away = np.hypot(*(situation.position - self._goals[self._next]).T)
            self._particle = int(situation.ids[np.argmin(away)])
        return self._particle

    def _learn(self, situation: Situation, strength: float) -> FieldCommand:
        if self._learning_since is None:
            self._learning_since = situation.t
        angle = excitation(situation.t - self._learning_since, self.parameters.learn_leg_s)
        progress = Progress(f'particle {self._particle}: learns how it answers to the field')
        return FieldCommand(field_along(situation, angle, strength), progress=progress)

    def _advance(self, position: np.ndarray) -> complex:
        """The way (complex) [m] to the present goal, after ticking off those reached."""
        arrival = units.to_si('arrival_um', self.parameters.arrival_um)
        while True:
            offset = complex(*(self._goals[self._next] - position).tolist())
            if abs(offset) > arrival:
                return offset
            if self._next == len(self._goals) - 1:
                self._done = True
                return offset
            self._next += 1
