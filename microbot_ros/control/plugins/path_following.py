"""Keep one particle on a path, with learned drift and speed."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    NO_PLACES,
    Controller,
    ControllerInput,
    FieldCommand,
    GoalError,
    Input,
    Progress,
    no_field,
)
from microbot_ros.control.planning.route import Route
from microbot_ros.control.steering.courses import Excitation, approach
from microbot_ros.control.steering.drift_compensator import DriftCompensator


@dataclass(frozen=True)
class PathFollowingParameters:
    """The particle, and how tightly it follows."""

    particle: int = setting(
        -1, 'Particle to drive; -1 takes the one nearest to the path.', lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    lookahead_um: float = setting(
        1.0, 'Length over which a cross-track error is corrected.', lower=0.1, upper=1000.0)
    hold_radius_um: float = setting(
        1.0, 'Radius of the circle around the end of an open path.', lower=0.1, upper=100.0)
    learn_leg_s: float = setting(
        0.5, 'Until the answer to the field is known: time on each side of a triangle.',
        lower=0.1, upper=60.0)


class PathFollowing(Controller):
    """Line of sight with integral action: course = direction of the path − atan(e/Δ), minus drift.

    e is the cross-track error, to the left, Δ the lookahead. The drift is learned on the way
    (`drift_compensator`). A closed path is followed repeatedly; at the end of an open one the
    particle circles. A new path starts at its nearest point.
    """

    interface_version = 1
    summary = 'Drive one particle along a path, against drift.'
    takes = frozenset({Input.PATH})
    Parameters = PathFollowingParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget path, particle and what was learned about it."""
        self._path = NO_PLACES
        self._route: Route | None = None
        self._along: float | None = None
        self._particle = -1
        self._compensator = DriftCompensator()
        self._excitation = Excitation()

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ParticleLostError if the selected particle is not in `inputs`."""
        if self.parameters.particle >= 0:
            inputs.index(self.parameters.particle)
        self._excitation.stop()
        self._along = None

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return a field along the path of `inputs`, or a triangle until the response is known."""
        self._take_path(inputs)
        if self._route is None:
            return no_field('waiting for a path')
        p, compensator = self.parameters, self._compensator
        row = self._choose(inputs, self._route)
        place, particles = compensator.look(inputs, row), inputs.ids[row:row + 1]
        strength = units.to_si('field_mT', p.field_mT)
        if not compensator.ready:
            return self._excitation.command(
                inputs, p.learn_leg_s, strength, particles=particles)
        self._excitation.stop()
        course, progress = self._course(place, self._route)
        field = compensator.steer(inputs, course, strength)
        return FieldCommand(field, progress=progress, particles=particles)

    def _take_path(self, inputs: ControllerInput) -> None:
        if np.array_equal(inputs.path, self._path):
            return
        inside = inputs.workspace.holds(inputs.path)
        if not inside.all():
            x, y = inputs.path[np.argmin(inside)] * 1e6
            raise GoalError(f'the path leaves the workspace at ({x:.0f}, {y:.0f}) µm')
        try:
            self._route = Route(inputs.path) if len(inputs.path) else None
        except ValueError as error:
            raise GoalError(str(error)) from None
        self._path, self._along = inputs.path, None

    def _choose(self, inputs: ControllerInput, route: Route) -> int:
        inputs.require_particles()
        particle = self.parameters.particle
        if particle < 0:
            particle = self._particle
            if particle not in inputs.ids:
                away = [abs(route.at(route.nearest(z, None, 0))[0] - z)
                        for z in (complex(*p) for p in inputs.position)]
                particle = int(inputs.ids[np.argmin(away)])
        row = inputs.index(particle)
        if particle != self._particle:
            self._particle, self._along = particle, None
        return row

    def _course(self, place: complex, route: Route) -> tuple[float, Progress]:
        lookahead = units.to_si('lookahead_um', self.parameters.lookahead_um)
        self._along = route.nearest(place, self._along, 4 * lookahead)
        point, way = route.at(self._along)
        left = ((place - point) * way.conjugate()).imag
        to_go = route.length - self._along
        message = f'particle {self._particle}: {left * 1e6:+.2f} µm off the path'
        if not route.closed and to_go <= lookahead:
            hold = units.to_si('hold_radius_um', self.parameters.hold_radius_um)
            away = abs(route.end - place)
            there = away <= lookahead + 2 * hold  # not where the end is only the nearest point
            return approach(route.end - place, hold), Progress(
                message, there, to_go if there else away)
        course = cmath.phase(way) - math.atan(left / lookahead)
        return course, Progress(message, False, math.nan if route.closed else to_go)
