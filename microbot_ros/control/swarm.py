"""Many rollers, each to a goal of its own, by what makes them different: their step-out."""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros import units
from microbot_ros.control.assignment import Assignment
from microbot_ros.control.contract import (
    NO_IDS,
    Controller,
    ControllerError,
    ControllerInput,
    FieldCommand,
    ModelError,
    NoSolutionError,
    ParticleLostError,
    Progress,
    Workspace,
    no_field,
)
from microbot_ros.control.shared import as_complex
from microbot_ros.control.steering import Excitation, field_along
from microbot_ros.control.step_out import ALIKE, Leg, SingleTurns
from microbot_ros.control.swarm_paths import Room, between, find_ways
from microbot_ros.settings import setting

LONGEST_S, SHORTEST_S = 8.0, 0.5
"""Of the ways that are done between two looks at where all have come to, in time of legs."""
TIGHT = 0.4
"""How much of the margins is kept on the detours of legs."""
AGAIN = 1.5
"""Times the distance of arrival from which on one that had arrived is brought back."""
SETTLE_TICKS = 2
"""After a leg, until those that lag have fallen back or come up."""
STANDING_HZ = 1e-3
"""At which the field stands, for what goes round keeps its direction while it turns."""


@dataclass(frozen=True)
class SwarmParameters:
    """What the rollers are, what stands in their way, and how far they keep from each other."""

    field_mT: float = setting(
        5.0, 'Strength of the field, at which the step-outs are meant.', lower=0.01, upper=100.0)
    step_outs_hz: list[float] = setting(
        [0.0], 'Frequency up to which particles 0, 1, 2, … follow the field.',
        lower=0.0, upper=1000.0)
    fastest_hz: float = setting(40.0, 'Highest frequency used.', lower=0.01, upper=1000.0)
    radius_um: float = setting(2.3, 'Radius of the particles.', lower=0.1, upper=100.0)
    walls_um: list[float] = setting(
        [0.0, 0.0, 0.0, 0.0], 'x, y of one end and x, y of the other of each straight wall, one '
        'after the other; ends that are the same: none.', lower=-10000.0, upper=10000.0)
    apart_um: float = setting(
        12.0, 'Room that plans leave between two particles, from surface to surface.',
        lower=0.0, upper=1000.0)
    off_walls_um: float = setting(
        6.5, 'Room that plans leave between a particle and a wall or the edge of the view.',
        lower=0.0, upper=1000.0)
    arrival_um: float = setting(
        3.0, 'A goal counts as reached from this close.', lower=0.05, upper=1000.0)
    learn_phi_std_rad: float = setting(
        0.1, 'It plans once φ of all is known this well.', lower=0.01, upper=1.5)
    learn_leg_s: float = setting(
        1.0, 'Until then: time on each side of a triangle.', lower=0.1, upper=60.0)


class Swarm(Controller):
    """Each roller to its own goal, past the others and the walls, at rest in the end.

    First it finds ways for all (`swarm_paths`), some of it at each tick. Then it does a part of
    them at a time: single turns of the field, which some follow and some do not (`step_out`), add
    up to what each is to be displaced by, and are ordered such that nobody goes far from its way.
    What each made of a turn is learned. Those without a goal stay where they are.
    """

    interface_version = 1
    summary = 'Many rollers, each to its own goal, by frequencies at which they step out.'
    Parameters = SwarmParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget goals, ways, and what they were planned with."""
        self._assignment = Assignment()
        self._excitation = Excitation()
        self._forget()

    def _forget(self) -> None:
        self._ids = NO_IDS
        self._search: Generator[None, None, np.ndarray] | None = None
        self._turns: SingleTurns | None = None
        self._ways: _Ways | None = None
        self._legs: deque[Leg] = deque()
        self._leg: tuple[Leg, np.ndarray] | None = None
        self._orders: deque[tuple[np.ndarray, float]] = deque()
        self._upright = False
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
        """ModelError for `inputs` without a model of particles that roll."""
        if inputs.model is None or inputs.model.propulsion != 'rolling':
            raise ModelError('drives rollers: set model_file to one that says propulsion: rolling')
        self._excitation.stop()
        self._forget()

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """For `inputs` the present leg; while it plans no field."""
        if self._assignment.update(inputs):
            self._forget()
        if not len(self._assignment.pairs(inputs)[0]):
            return no_field('waits for goals')
        try:
            return self._drive(inputs)
        except ControllerError:
            self._stop()
            raise

    def _drive(self, inputs: ControllerInput) -> FieldCommand:
        p = self.parameters
        if self._turns is None:
            known = inputs.learned(p.learn_phi_std_rad) & (inputs.speed > 0)
            if not known.all():
                slowest = float(self._step_outs(inputs).min()) / 2
                return self._excitation.command(
                    inputs, p.learn_leg_s, units.to_si('field_mT', p.field_mT), particles=None,
                    frequency=min(slowest, inputs.limits.frequency))
            self._begin(inputs)
        if self._ways is None and not self._planned():
            return no_field('looks for ways')
        return self._follow(inputs)

    def _step_outs(self, inputs: ControllerInput) -> np.ndarray:
        """Of all in `inputs` (N,) [Hz]; ModelError where one's is not known."""
        told = np.array(self.parameters.step_outs_hz)
        known = (inputs.ids >= 0) & (inputs.ids < len(told))
        step_outs = np.where(known, told[np.where(known, inputs.ids, 0)], 0.0)
        if not (step_outs > 0).all():
            raise ModelError('step_outs_hz does not say at which frequency particle '
                             f'{inputs.ids[np.argmin(step_outs > 0)]} steps out')
        return step_outs

    def _begin(self, inputs: ControllerInput) -> None:
        """Start to look for ways, with what is known now: those who slip teach nothing."""
        p = self.parameters
        step_outs = self._step_outs(inputs)
        order = np.argsort(step_outs)
        alike = np.flatnonzero(np.diff(np.log(step_outs[order])) <= math.log(ALIKE))
        if alike.size:
            a, b = inputs.ids[order[alike[0]:alike[0] + 2]]
            raise NoSolutionError(f'particles {a} and {b} step out at so much the same frequency '
                                  'that no field tells them apart')
        tick = inputs.dt if inputs.dt > 0 else 1 / 60
        self._pause = math.ceil(inputs.delay / tick) + SETTLE_TICKS
        turns = SingleTurns(inputs.speed * np.exp(1j * inputs.phi), step_outs,
                            min(p.fastest_hz, inputs.limits.frequency), tick, self._pause)
        start = as_complex(inputs.position)
        goal = start.copy()
        rows, goals = self._assignment.pairs(inputs)
        goal[rows] = as_complex(goals)
        self._ids, self._turns = inputs.ids.copy(), turns
        self._search = find_ways(start, goal, self._room(inputs.workspace, 1.0))

    def _room(self, view: Workspace, share: float) -> Room:
        """What they keep from each other and from walls, with a `share` of the margins."""
        p = self.parameters
        radius, apart, off = units.to_si(
            'radius_um', np.array([p.radius_um, p.apart_um, p.off_walls_um]))
        x, y, to_x, to_y = units.to_si('walls_um', np.array(p.walls_um)).reshape(-1, 4).T
        walls = np.stack([x + 1j * y, to_x + 1j * to_y], axis=1)
        return Room(view, walls[walls[:, 0] != walls[:, 1]], 2 * radius + share * apart,
                    radius + share * off)

    def _planned(self) -> bool:
        """Go on looking for ways; whether they are found."""
        assert self._search is not None
        assert self._turns is not None
        try:
            next(self._search)
        except StopIteration as found:
            self._ways = _Ways(found.value, self._turns)
        return self._ways is not None

    def _follow(self, inputs: ControllerInput) -> FieldCommand:
        """The next tick of the present leg, or of one to come."""
        here, ways = self._look(inputs), self._ways
        assert ways is not None
        far = float(np.abs(here - ways.end).max())
        if not self._orders:
            self._next(inputs, here, ways, far)
        progress = Progress(f'{len(here)} rollers, {ways.left:.0f} s of legs before them, the '
                            f'last {far * 1e6:.1f} µm from its goal', self._arrived, far)
        # None is given over to be kept in view: that takes a frequency for the speed, and would
        # turn the field for one that has stepped out. The ways and the legs stay in view.
        field, frequency = self._orders.popleft() if self._orders else (np.zeros(2), 0.0)
        return FieldCommand(field, frequency, progress, NO_IDS)

    def _stop(self) -> None:
        """No field flows."""
        self._legs.clear()
        self._orders.clear()
        self._leg, self._upright = None, False

    def _next(self, inputs: ControllerInput, here: np.ndarray, ways: _Ways, far: float) -> None:
        """Order the next leg, if any, from where all are at rest, the last `far` [m] from its
        goal.
        """
        assert self._turns is not None
        if self._leg:
            self._turns.learn(self._leg[0], here - self._leg[1])
            self._leg = None
        if not self._legs:
            arrival = units.to_si('arrival_um', self.parameters.arrival_um)
            self._arrived = ways.through and far <= arrival * (AGAIN if self._arrived else 1.0)
            if self._arrived:
                return self._stop()
            if self._upright:
                self._plan_legs(inputs, here, ways)
        if not self._upright:
            # What goes round begins along the way, in the plane. Upright it lies across every
            # axis, so that no change of way moves anybody: all begin and end there.
            self._order(inputs, Leg(0, 1 + 0j), 0.25)
            self._upright = True
        elif self._legs:
            self._leg = self._legs.popleft(), here
            self._order(inputs, self._leg[0], 1.0)
        return None

    def _order(self, inputs: ControllerInput, leg: Leg, part: float) -> None:
        """Field [T] and frequency [Hz] of the ticks of `part` of a leg, and of the rest after."""
        assert self._turns is not None
        strength = units.to_si('field_mT', self.parameters.field_mT)
        field = field_along(
            inputs, cmath.phase(leg.way), float(self._turns.share[leg.kind]) * strength)
        turning = float(self._turns.frequency[leg.kind])
        self._orders.extend([(field, part * turning)] * int(self._turns.ticks[leg.kind]))
        self._orders.extend([(field, STANDING_HZ)] * self._pause)

    def _look(self, inputs: ControllerInput) -> np.ndarray:
        """Where all are (N,) [m]; ParticleLostError where one is not seen."""
        lost = np.setdiff1d(self._ids, inputs.ids)
        if lost.size:
            raise ParticleLostError(f'particle {lost[0]} is not seen')
        order = np.argsort(inputs.ids)
        rows = order[np.searchsorted(inputs.ids, self._ids, sorter=order)]
        return as_complex(inputs.position[rows])

    def _plan_legs(self, inputs: ControllerInput, here: np.ndarray, ways: _Ways) -> None:
        """As long a part of the ways as goes without anybody coming near to anything."""
        assert self._turns is not None
        room = self._room(inputs.workspace, TIGHT)
        reach, best, chosen = min(2 * self._reach, LONGEST_S), -math.inf, []
        while True:
            legs = self._turns.legs(ways.ahead(reach) - here)
            slack = _slack(here, self._turns.moves(legs), room)
            if slack > best:
                chosen, best, self._reach = legs, slack, reach
            if slack >= 0 or reach <= SHORTEST_S:
                break
            reach /= 2
        ways.advance(self._reach)
        self._legs.extend(chosen)


class _Ways:
    """How far all have come on their ways, in seconds of legs."""

    def __init__(self, ways: np.ndarray, turns: SingleTurns) -> None:
        took = [turns.time(step) for step in np.diff(ways, axis=0)]
        self._ways, self._times = ways, np.concatenate([[0.0], np.cumsum(took)])
        self._at = 0.0

    @property
    def end(self) -> np.ndarray:
        """The goals (N,) [m]."""
        return np.asarray(self._ways[-1])

    @property
    def left(self) -> float:
        """What is left [s]."""
        return float(self._times[-1] - self._at)

    @property
    def through(self) -> bool:
        """Whether nothing is left."""
        return self.left <= 0

    def ahead(self, seconds: float) -> np.ndarray:
        """Where all should be (N,) [m] so many `seconds` of legs from here."""
        t = min(self._at + seconds, self._times[-1])
        return np.array([np.interp(t, self._times, way) for way in self._ways.T])

    def advance(self, seconds: float) -> None:
        """So many `seconds` are done."""
        self._at = min(self._at + seconds, self._times[-1])


def _slack(here: np.ndarray, moves: np.ndarray, room: Room) -> float:
    """How much nearer [m] anybody could come to anything, from `here` (N,) on by `moves` (N, L)
    [m].
    """
    if not moves.size:
        return math.inf
    ways = here + np.cumsum(moves, axis=1).T
    return float(min((between(ways) - room.apart).min(),
                     (room.to_walls(ways) - room.off_walls).min()))
