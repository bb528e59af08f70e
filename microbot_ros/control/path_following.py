"""Keeps one particle on a path, against a drift it learns, at a speed it learns."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from microbot_ros import units
from microbot_ros.control.contract import (
    NO_PLACES,
    Controller,
    FieldCommand,
    GoalError,
    ParticleLostError,
    Progress,
    Situation,
    no_field,
)
from microbot_ros.control.drift_observer import DriftObserver
from microbot_ros.control.forecast import FieldRecord
from microbot_ros.control.route import Route
from microbot_ros.control.steering import Excitation, approach, field_along
from microbot_ros.settings import setting

UNKNOWN_SPEED = 10e-6
"""Prior standard deviation of the answer to the field [m/s] where nothing is known."""


@dataclass(frozen=True)
class PathFollowingParameters:
    """Whom to drive, and how tightly."""

    particle: int = setting(
        -1, 'Particle to drive; -1 takes the one nearest to the path.', lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.01, upper=100.0)
    lookahead_um: float = setting(
        1.0, 'Cross-track error is undone within about this length.', lower=0.1, upper=1000.0)
    drift_um_s: float = setting(
        1.0, 'The drift that may be expected.', lower=0.0, upper=100.0)
    hold_radius_um: float = setting(
        1.0, 'Radius of the circle around the end of an open path.', lower=0.1, upper=100.0)
    learn_leg_s: float = setting(
        0.5, 'Until the answer to the field is known: time on each side of a triangle.',
        lower=0.1, upper=60.0)


class PathFollowing(Controller):
    """Line of sight with integral action: course = the path's direction − atan(e/Δ), crabbed.

    e is the cross-track error, to the left, Δ the lookahead. The crab angle that makes up for
    the drift, and the particle's own speed and φ, come from a filter that runs along; estimates
    in the situation only start it. A closed path is followed round and round; at the end of an
    open one the particle circles. A new path starts at its nearest point.
    """

    interface_version = 1
    summary = 'One particle along a path, against drift.'
    Parameters = PathFollowingParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget path, particle and what was learned of it."""
        self._path = NO_PLACES
        self._route: Route | None = None
        self._along: float | None = None
        self._particle = -1
        self._forget()

    def _forget(self) -> None:
        self._observer: DriftObserver | None = None
        self._record = FieldRecord()
        self._seen = self._asked = -math.inf
        self._excitation = Excitation()

    def activate(self, situation: Situation) -> None:
        """ParticleLostError where the particle asked for is not seen."""
        if self.parameters.particle >= 0:
            situation.index(self.parameters.particle)
        self._forget()

    def compute(self, situation: Situation) -> FieldCommand:
        """Along the path, or a triangle until the particle's answer to the field is known."""
        self._take_path(situation)
        if self._route is None:
            return no_field('waits for a path')
        place, observer = self._observe(situation, self._choose(situation, self._route))
        strength = units.to_si('field_mT', self.parameters.field_mT)
        if not observer.answer_std <= 0.2 * abs(observer.answer):
            return self._excitation.command(situation, self.parameters.learn_leg_s, strength)
        course, progress = self._course(place, self._route)
        crab = -(observer.drift * cmath.exp(-1j * course)).imag / abs(observer.answer)
        course += math.asin(min(max(crab, -1.0), 1.0))
        field = field_along(situation, course - cmath.phase(observer.answer), strength)
        return FieldCommand(field, progress=progress)

    def _take_path(self, situation: Situation) -> None:
        if np.array_equal(situation.path, self._path):
            return
        inside = situation.workspace.holds(situation.path)
        if not inside.all():
            x, y = situation.path[np.argmin(inside)] * 1e6
            raise GoalError(f'the path leaves the workspace at ({x:.0f}, {y:.0f}) µm')
        try:
            self._route = Route(situation.path) if len(situation.path) else None
        except ValueError as error:
            raise GoalError(str(error)) from None
        self._path, self._along = situation.path, None

    def _choose(self, situation: Situation, route: Route) -> int:
        if not len(situation.ids):
            raise ParticleLostError('no particle is seen')
        particle = self.parameters.particle
        if particle < 0:
            particle = self._particle
            if particle not in situation.ids:
                away = [abs(route.at(route.nearest(z, None, 0))[0] - z)
                        for z in (complex(*p) for p in situation.position)]
                particle = int(situation.ids[np.argmin(away)])
        row = situation.index(particle)
        if particle != self._particle:
            self._particle, self._along = particle, None
            self._forget()
        return row

    def _observe(self, situation: Situation, row: int) -> tuple[complex, DriftObserver]:
        """Where the particle will be when the command acts, and what is known of it."""
        exposed = situation.t - situation.age
        measured = complex(*situation.position[row].tolist())
        self._record.note(self._asked + situation.delay, situation.field, situation.frequency)
        self._asked = situation.t
        observer = self._observer
        if observer is None:
            observer = self._observer = _start(situation, row, measured, self.parameters)
            self._seen = exposed
        elif exposed > self._seen:
            shared = self._record.shared(self._seen, exposed)
            sigma = float(situation.sigma[row])
            observer.update(shared, exposed - self._seen, measured,
                            sigma if sigma > 0 else 1e-7)
            self._seen = exposed
        acts = situation.t + situation.delay
        return observer.ahead(self._record.shared(self._seen, acts), acts - self._seen), observer

    def _course(self, place: complex, route: Route) -> tuple[float, Progress]:
        lookahead = units.to_si('lookahead_um', self.parameters.lookahead_um)
        self._along = route.nearest(place, self._along, 4 * lookahead)
        point, way = route.at(self._along)
        left = ((place - point) * way.conjugate()).imag
        to_go = route.length - self._along
        message = f'particle {self._particle}: {left * 1e6:+.2f} µm off the path'
        if not route.closed and to_go <= lookahead:
            hold = units.to_si('hold_radius_um', self.parameters.hold_radius_um)
            return approach(route.end - place, hold), Progress(message, True, to_go)
        course = cmath.phase(way) - math.atan(left / lookahead)
        return course, Progress(message, False, math.nan if route.closed else to_go)


def _start(situation: Situation, row: int, measured: complex,
           parameters: PathFollowingParameters) -> DriftObserver:
    drift_std = units.to_si('drift_um_s', parameters.drift_um_s)
    speed, phi = float(situation.speed[row]), float(situation.phi[row])
    std = math.hypot(float(situation.speed_std[row]), speed * float(situation.phi_std[row]))
    if std <= UNKNOWN_SPEED and math.isfinite(phi):
        return DriftObserver(measured, cmath.rect(speed, phi), std, drift_std)
    return DriftObserver(measured, 0j, UNKNOWN_SPEED, drift_std)
