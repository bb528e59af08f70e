"""Push a bead, which no field moves, along a path with a roller."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    ControllerInput,
    FieldCommand,
    Input,
    ParticleLostError,
    Progress,
    no_field,
)
from microbot_ros.control.plugins.path_following import PathFollowing, PathFollowingParameters
from microbot_ros.control.steering.courses import field_along
from microbot_ros.control.steering.drift_compensator import DriftCompensator

STEER = 1.5
"""Choice: extra lean of the roller per angle between its line through the bead and the course."""
STEEPEST = 1.2
"""Choice: largest lean [rad]."""
SLIPS = 1.2
"""Choice: angle [rad] between push and course from which the roller goes round the bead."""
BEHIND = 0.4
"""Choice: angle [rad] from the place behind the bead within which it pushes again."""
ROUND = 0.6
"""Choice: how far ahead [rad] on its circle the roller aims when it goes round."""


@dataclass(frozen=True)
class PushingParameters(PathFollowingParameters):
    """The bead, the roller, and how it pushes."""

    particle: int = setting(
        -1, 'Particle that is the bead; -1 takes the particle nearest to the '
            'path.', lower=-1, upper=2**31 - 1)
    lookahead_um: float = setting(
        8.0, 'Length over which a cross-track error of the bead is corrected.',
        lower=0.1, upper=1000.0)
    pusher: int = setting(
        -1, 'Particle that is the roller; -1 takes the particle nearest to the '
            'bead.', lower=-1, upper=2**31 - 1)
    apart_um: float = setting(
        4.6, 'Distance of the centres when the two touch.', lower=0.1, upper=1000.0)
    arrival_um: float = setting(
        1.0, 'Remaining length of an open path at which it counts as '
             'done.', lower=0.05, upper=1000.0)
    round_um: float = setting(
        10.0, 'Distance of the centres while the roller moves around the '
              'bead.', lower=0.2, upper=1000.0)
    pushing_hz: float = setting(4.0, 'Rotation frequency while the '
                                     'roller pushes.', lower=0.01, upper=1000.0)
    fastest_hz: float = setting(
        5.0, 'Rotation frequency on the way to the bead, below the '
             'step-out.', lower=0.01, upper=1000.0)


class Pushing(PathFollowing):
    """Leads the bead along the path by line of sight, as `path_following` leads a particle.

    The bead moves along the line from the roller through its centre. That line is unstable: the
    roller leans against it, by `STEER` times the angle between line and course. If it still slips
    off, it goes round the bead on a circle to the place behind it. It stops at the end of an open
    path.
    """

    summary = 'Push a bead along a path with one roller.'
    takes = frozenset({Input.PATH})
    Parameters = PushingParameters

    def configure(self, parameters: PushingParameters) -> None:
        """Take `parameters`; ValueError if the circle is narrower than the contact distance."""
        if not parameters.round_um > parameters.apart_um:
            raise ValueError(f'round_um must be more than apart_um; received '
                             f'{parameters.round_um:g} and {parameters.apart_um:g}')
        super().configure(parameters)

    def reset(self) -> None:
        """Forget path, particles and what was learned about them."""
        super().reset()
        self._compensator = DriftCompensator(rolling=True)
        self._pusher = -1
        self._pushes = False

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ModelError for `inputs` without a model of rollers."""
        inputs.require_rollers()
        super().activate(inputs)
        self._pushes = False

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return for `inputs` a push, or a move to the place behind the bead."""
        self._take_path(inputs)
        if self._route is None:
            return no_field('waiting for a path')
        p, compensator = self.parameters, self._compensator
        bead = self._choose(inputs, self._route)
        row = self._choose_pusher(inputs, bead)
        place, particles = compensator.look(inputs, row), inputs.ids[[bead, row]]
        strength = units.to_si('field_mT', p.field_mT)
        if not compensator.ready:
            return self._excitation.command(
                inputs, p.learn_leg_s, strength, particles=inputs.ids[row:row + 1],
                frequency=min(p.fastest_hz, inputs.limits.frequency))
        self._excitation.stop()
        centre = complex(*inputs.position[bead].tolist())
        course, progress = self._course(centre, self._route)
        if progress.done:
            course = cmath.phase(self._route.end - centre)
            if progress.distance <= units.to_si('arrival_um', p.arrival_um):
                return FieldCommand(np.zeros(2), progress=progress)
        heading, frequency, what = self._move(place - centre, course)
        field = field_along(inputs, heading - cmath.phase(compensator.answer), strength)
        message = f'particle {self._pusher} {what}; {progress.message}'
        return FieldCommand(field, min(frequency, inputs.limits.frequency),
                            Progress(message, False, progress.distance), particles)

    def _choose_pusher(self, inputs: ControllerInput, bead: int) -> int:
        """Return the row of the roller; ParticleLostError if there is none."""
        pusher = self.parameters.pusher
        if pusher < 0:
            pusher = self._pusher
            if pusher not in inputs.ids or pusher == inputs.ids[bead]:
                away = np.hypot(*(inputs.position - inputs.position[bead]).T)
                away[bead] = np.inf
                pusher = int(inputs.ids[np.argmin(away)])
        if pusher == inputs.ids[bead]:
            raise ParticleLostError('no other particle is tracked that could push particle '
                                    f'{pusher}')
        self._pusher = pusher
        return inputs.index(pusher)

    def _move(self, offset: complex, course: float) -> tuple[float, float, str]:
        """Return heading [rad], frequency [Hz] and a verb at an `offset` [m] from the bead.

        The bead is to move along `course` [rad].
        """
        p = self.parameters
        touch, wide = units.to_si('apart_um', p.apart_um), units.to_si('round_um', p.round_um)
        push = cmath.phase(-offset)
        off = math.remainder(push - course, math.tau)
        slips = SLIPS if self._pushes else BEHIND
        self._pushes = abs(off) <= slips and abs(offset) <= wide + touch
        if self._pushes:
            lean = min(max(STEER * off, -STEEPEST), STEEPEST)
            return push + lean, p.pushing_hz, 'pushes'
        ahead = min(max(-off, -ROUND), ROUND)
        aim = cmath.rect(wide, cmath.phase(offset) + ahead) - offset
        return cmath.phase(aim), p.fastest_hz, 'goes round'
