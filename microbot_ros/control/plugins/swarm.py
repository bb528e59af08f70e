"""Drive many rollers, each to its own goal, by their different step-out frequencies."""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    ANY_GOALS,
    NO_IDS,
    Controller,
    ControllerError,
    ControllerInput,
    FieldCommand,
    NoSolutionError,
    ParticleLostError,
    Progress,
    Workspace,
    no_field,
)
from microbot_ros.control.planning.assignment import Assignment
from microbot_ros.control.planning.shared import as_complex
from microbot_ros.control.planning.step_out import Leg, SingleTurns
from microbot_ros.control.planning.swarm_paths import Room, between, find_ways
from microbot_ros.control.steering.courses import field_along

LONGEST_S, SHORTEST_S = 6.0, 0.5
"""Choice: longest and shortest part of the paths between two plans, in time of legs [s]."""
TIGHT = 0.6
"""Choice: share of the margins that is kept on the detours of legs."""
AGAIN = 1.5
"""Choice: multiple of the arrival distance beyond which an arrived roller is brought back."""
FRAMES = 9
"""Choice: frame intervals whose median is the frame interval."""
STANDING_HZ = 1e-3
"""Choice: frequency of a standing field, above 0 because rotating fields keep their axis."""


@dataclass(frozen=True)
class SwarmParameters:
    """The rollers, the walls, and the distances to keep."""

    field_mT: float = setting(
        5.0, 'Strength of the field, for which the step-out frequencies '
             'hold.', lower=0.01, upper=100.0)
    slowest_hz: float = setting(
        4.5, 'Frequency up to which all particles follow the field.', lower=0.01, upper=1000.0)
    fastest_hz: float = setting(
        40.0, 'Highest frequency used; hardly any particle follows beyond it.', lower=0.01,
        upper=1000.0)
    radius_um: float = setting(2.3, 'Radius of the particles.', lower=0.1, upper=100.0)
    walls_um: list[float] = setting(
        [0.0, 0.0, 0.0, 0.0], 'Straight walls: x, y of one end and x, y of the '
                              'other end of each, in sequence; equal ends: no '
                              'wall.', lower=-10000.0, upper=10000.0)
    apart_um: float = setting(
        12.0, 'Gap that plans leave between two particles, surface to surface.',
        lower=0.0, upper=1000.0)
    off_walls_um: float = setting(
        7.0, 'Gap that plans leave between a particle and a wall or the edge of the view.',
        lower=0.0, upper=1000.0)
    arrival_um: float = setting(
        3.0, 'Distance below which a goal counts as reached.', lower=0.05, upper=1000.0)


class Swarm(Controller):
    """Drives each roller to its own goal, past the others and the walls; all rest at the end.

    First it surveys which single turns of the field each roller follows (`step_out`); nothing else
    is needed. Then it finds paths for all (`swarm_paths`), a bit at each tick, and executes them
    in parts: turns that add up to the displacement of each roller, ordered such that none goes far
    from its path. Rollers without a goal stay where they are.
    """

    interface_version = 1
    summary = 'Drive many rollers, each to its own goal, by frequencies at which they step out.'
    takes = ANY_GOALS
    Parameters = SwarmParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget goals, paths and the survey."""
        self._assignment = Assignment()
        self._forget()

    def _forget(self) -> None:
        self._ids = NO_IDS
        self._frames: list[float] = []
        self._turns: SingleTurns | None = None
        self._surveyed: list[np.ndarray] = []
        self._legs: deque[Leg] = deque()
        self._leg: tuple[Leg, np.ndarray] | None = None
        self._orders: deque[tuple[np.ndarray, float]] = deque()
        self._standing = np.zeros(2)
        self._upright = False
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Forget the paths, but not the survey."""
        self._search: Generator[None, None, _Ways] | None = None
        self._ways: _Ways | None = None
        self._plan: Generator[None, None, None] | None = None
        self._refused: ControllerError | None = None
        self._reach = SHORTEST_S
        self._arrived = False

    def configure(self, parameters: Any) -> None:
        """Take `parameters`; ValueError for walls that are not four numbers each."""
        if len(parameters.walls_um) % 4:
            raise ValueError('walls_um must be x, y, x, y of each, received '
                             f'{len(parameters.walls_um)} numbers')
        super().configure(parameters)
        self._forget()

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ModelError for `inputs` without a model of rollers."""
        inputs.require_rollers()
        self._forget()

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the present leg for `inputs`; no field while it plans."""
        if self._assignment.update(inputs):
            if self._search is not None:
                self._stop()
            self._begin_anew()
        if not len(self._assignment.pairs(inputs)[0]):
            self._stop()
            return no_field('waiting for goals')
        try:
            return self._drive(inputs)
        except ParticleLostError:
            if self._search is None:
                self._forget()
            self._stop()
            raise

    def _drive(self, inputs: ControllerInput) -> FieldCommand:
        if self._turns is None and not self._ready(inputs):
            return no_field('measuring the frame rate')
        here = self._look(inputs)
        if not self._orders:
            self._note_leg(here)
            if self._ways is None:
                self._prepare(inputs, here)
            else:
                self._next(inputs, here, self._ways)
            self._upright = bool(self._orders)
        # No particle is passed on to be kept in view: that would take the frequency for the speed
        # and turn the field for a roller that has stepped out. Paths and legs stay in view.
        field, frequency = self._orders.popleft() if self._orders else (np.zeros(2), 0.0)
        return FieldCommand(field, frequency, self._progress(here), NO_IDS)

    def _progress(self, here: np.ndarray) -> Progress:
        if self._search is None:
            return Progress(f'measuring which rotations {len(here)} rollers follow')
        if self._ways is None:
            return Progress('planning paths')
        far = float(np.abs(here - self._ways.end).max())
        return Progress(f'{len(here)} rollers, {self._ways.left:.0f} s to '
                        f'go, the farthest {far * 1e6:.1f} µm from its '
                        'goal', self._arrived, far)

    def _ready(self, inputs: ControllerInput) -> bool:
        """Measure the frame interval; then prepare the survey and return True."""
        if inputs.dt > 0:
            self._frames.append(inputs.dt)
        if len(self._frames) < FRAMES:
            return False
        p, tick = self.parameters, float(np.median(self._frames))
        fastest = min(p.fastest_hz, inputs.limits.frequency)
        self._turns = SingleTurns(min(p.slowest_hz, fastest), fastest, tick,
                                  math.ceil(inputs.delay / tick))
        self._ids = np.sort(inputs.ids)
        self._legs.extend(self._turns.survey())
        return True

    def _prepare(self, inputs: ControllerInput, here: np.ndarray) -> None:
        """Continue the survey, or after it the search for paths from `here` (N,) [m]."""
        if self._legs:
            return self._order_next(inputs, here)
        if self._refused is not None:
            raise self._refused
        try:
            if self._search is None:
                self._search = self._find_ways(inputs, here)
            next(self._search)
        except StopIteration as found:
            self._ways = found.value
        except NoSolutionError as error:
            self._refused = error
            raise
        return None

    def _find_ways(self, inputs: ControllerInput, here: np.ndarray,
                   ) -> Generator[None, None, _Ways]:
        """Find paths from `here` (N,) [m] to the goals, with the result of the survey."""
        assert self._turns is not None
        self._turns.see(np.array(self._surveyed))
        ways = yield from find_ways(here, self._goals(inputs, here),
                                    self._room(inputs.workspace, 1.0))
        took = []
        for step in np.diff(ways, axis=0):
            took.append(self._turns.time(step))
            yield
        return _Ways(ways, np.array(took))

    def _goals(self, inputs: ControllerInput, here: np.ndarray) -> np.ndarray:
        """Return the goals (N,) [m]; rollers without one stay `here` (N,)."""
        goal = here.copy()
        rows, goals = self._assignment.pairs(inputs)
        _, mine, given = np.intersect1d(self._ids, inputs.ids[rows], return_indices=True)
        goal[mine] = as_complex(goals[given])
        return goal

    def _note_leg(self, here: np.ndarray) -> None:
        """Record the displacement of the leg that has ended `here` (N,) [m]."""
        if self._leg is None:
            return
        assert self._turns is not None
        leg, began = self._leg
        if self._ways is None:
            self._surveyed.append(here - began)
        else:
            self._turns.learn(leg, here - began)
        self._leg = None

    def _room(self, view: Workspace, share: float) -> Room:
        """Return the distances to keep, with a `share` of the margins."""
        p = self.parameters
        radius, apart, off = units.to_si(
            'radius_um', np.array([p.radius_um, p.apart_um, p.off_walls_um]))
        x, y, to_x, to_y = units.to_si('walls_um', np.array(p.walls_um)).reshape(-1, 4).T
        walls = np.stack([x + 1j * y, to_x + 1j * to_y], axis=1)
        return Room(view, walls[walls[:, 0] != walls[:, 1]], 2 * radius + share * apart,
                    radius + share * off)

    def _stop(self) -> None:
        """Drop all orders: no field."""
        self._legs.clear()
        self._orders.clear()
        self._leg, self._plan, self._upright = None, None, False

    def _next(self, inputs: ControllerInput, here: np.ndarray, ways: _Ways) -> None:
        """Order the next leg on the paths from `here` (N,) [m], if any remains."""
        if not self._legs:
            arrival = units.to_si('arrival_um', self.parameters.arrival_um)
            far = float(np.abs(here - ways.end).max())
            self._arrived = ways.through and far <= arrival * (AGAIN if self._arrived else 1.0)
            if self._arrived:
                return self._stop()
            if self._upright and self._plans(inputs, here, ways):
                return self._orders.append((self._standing, STANDING_HZ))
        if self._legs or not self._upright:
            self._order_next(inputs, here)
        return None

    def _plans(self, inputs: ControllerInput, here: np.ndarray, ways: _Ways) -> bool:
        """Plan the next legs from `here` (N,) [m], a bit per tick; return whether that goes on."""
        if self._plan is None:
            self._plan = self._plan_legs(inputs.workspace, here, ways)
        for _ in self._plan:
            return True
        self._plan = None
        return False

    def _order_next(self, inputs: ControllerInput, here: np.ndarray) -> None:
        """Order a leg from `here` (N,) [m], or before the first one an upright field.

        A rotation starts along its direction, in the plane. Upright, the field is perpendicular to
        every axis, so that a change of direction moves no roller: all legs start and end there.
        """
        if self._upright:
            self._leg = self._legs.popleft(), here
            self._order(inputs, self._leg[0], 1.0)
        else:
            self._order(inputs, Leg(0, 1 + 0j), 0.25)

    def _order(self, inputs: ControllerInput, leg: Leg, part: float) -> None:
        """Order field [T] and frequency [Hz] of `part` of a leg, and of the rest after it."""
        assert self._turns is not None
        strength = units.to_si('field_mT', self.parameters.field_mT)
        field = field_along(
            inputs, cmath.phase(leg.way), float(self._turns.share[leg.kind]) * strength)
        turning = float(self._turns.frequency[leg.kind])
        self._orders.extend([(field, part * turning)] * int(self._turns.ticks[leg.kind]))
        self._orders.extend([(field, STANDING_HZ)] * int(self._turns.rest[leg.kind]))
        self._standing = field

    def _look(self, inputs: ControllerInput) -> np.ndarray:
        """Return all positions (N,) [m]; ParticleLostError if one is not tracked."""
        lost = np.setdiff1d(self._ids, inputs.ids)
        if lost.size:
            raise ParticleLostError(f'particle {lost[0]} is not tracked')
        order = np.argsort(inputs.ids)
        rows = order[np.searchsorted(inputs.ids, self._ids, sorter=order)]
        return as_complex(inputs.position[rows])

    def _plan_legs(self, view: Workspace, here: np.ndarray, ways: _Ways,
                   ) -> Generator[None, None, None]:
        """Plan the longest part of the paths that keeps all distances."""
        assert self._turns is not None
        room = self._room(view, TIGHT)
        reach, best, chosen = min(2 * self._reach, LONGEST_S), -math.inf, []

        def slack_after(moved: np.ndarray) -> np.ndarray:
            return _slack(here[:, None] + moved, room)

        while True:
            legs = self._turns.legs(ways.ahead(reach) - here, slack_after)
            slack = slack_after(self._turns.moves(legs).cumsum(1)).min(initial=math.inf)
            if slack > best:
                chosen, best, self._reach = legs, slack, reach
            if slack >= 0 or reach <= SHORTEST_S:
                break
            reach /= 2
            yield
        ways.advance(self._reach)
        self._legs.extend(chosen)


class _Ways:
    """Progress of all rollers on their paths, in seconds of legs."""

    def __init__(self, ways: np.ndarray, took: np.ndarray) -> None:
        self._ways, self._times = ways, np.concatenate([[0.0], np.cumsum(took)])
        self._at = 0.0

    @property
    def end(self) -> np.ndarray:
        """Goals (N,) [m]."""
        return np.asarray(self._ways[-1])

    @property
    def left(self) -> float:
        """Remaining time [s]."""
        return float(self._times[-1] - self._at)

    @property
    def through(self) -> bool:
        """Whether nothing remains."""
        return self.left <= 0

    def ahead(self, seconds: float) -> np.ndarray:
        """Return the intended positions (N,) [m] after `seconds` of legs from now."""
        t = min(self._at + seconds, self._times[-1])
        return np.array([np.interp(t, self._times, way) for way in self._ways.T])

    def advance(self, seconds: float) -> None:
        """Count `seconds` of legs as done."""
        self._at = min(self._at + seconds, self._times[-1])


def _slack(place: np.ndarray, room: Room) -> np.ndarray:
    """Return the smallest clearance (C,) [m] for positions `place` (N, C)."""
    return np.asarray(np.minimum((between(place.T) - room.apart).min(-1),
                                 (room.to_walls(place) - room.off_walls).min(0)))
