"""Rollers that a controller drives, without ROS: fields sample by sample, moments that slip.

The physics is finer than what any controller here knows: the field goes round as the driver makes
it go round, the moment of each roller follows in three dimensions as far as it can (`rolling`),
and the `World` moves them, with Brownian motion and contact.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Limits,
    Workspace,
)
from microbot_ros.control.deadline_worker import UnhurriedWorker
from microbot_ros.control.manager import ControllerManager, Outcome
from microbot_ros.drive.rotation import Rotation, Turning
from microbot_ros.model.model import Model
from microbot_ros.model.physics.particle import Fluid, rotational_drag
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.rolling import Rolling
from microbot_ros.virtual_rig.world import World

FIELD = 5e-3
"""Strength [T] at which step-out frequencies are meant."""
VIEW = Workspace(np.array([-140e-6, -104e-6]), np.array([140e-6, 104e-6]))
FLUID = Fluid(viscosity=1e-3, height=2.6e-6)
"""Water, in which spheres of 2.3 µm roll 0.3 µm above the floor."""
_SAMPLE_S = 1e-3
_SIGMA = 5e-8
_QUICK_S = 5e-4


@dataclass(frozen=True)
class Rollers:
    """What each is (N,): `gain` [m per turn], `phi` [rad], `step_out` [Hz] at `FIELD`, `radius`
    [m]. One whose gain is 0 is a bead, which no field moves.
    """

    gain: np.ndarray
    phi: np.ndarray
    step_out: np.ndarray
    radius: np.ndarray

    def bodies(self, position: np.ndarray) -> np.ndarray:
        """At `position` (N, 2) [m]. What they roll stirs the water."""
        moment = rotational_drag(FLUID, self.radius) / (_QUICK_S * FIELD)
        made = bodies(FLUID, self.radius, moment, self.phi, position, gain=self.gain)
        made['stir'] = np.where(self.gain > 0, stirring(self.radius), 0.0)
        return made


def stirring(radius: np.ndarray) -> np.ndarray:
    """`BODY.stir` (N,) [m⁴ per turn] of spheres of a `radius` (N,) [m] that turn on the floor.

    The flow far from a torque 8πηa³ω along a floor at the height h, at that height, is
    6ωa³h cos ϑ/r³ outward (Blake and Chwang, Journal of Engineering Mathematics 8, 23 (1974)).
    """
    return np.asarray(6 * math.tau * radius**3 * (FLUID.height or 0.0))


class RollingLoop:
    """A `world` of `rollers`, a camera, and a controller that has been `told` of them.

    They begin at `position` (N, 2) [m], between `walls` (W, 4) [m] as a `World` has them; `seed`
    decides all chance. The controller sees every `period` [s] where they are, with 50 nm of
    noise; what it commands acts `delay` [s] later. `told` are the gain [m per turn] and φ [rad]
    that it is given for each, (N,) and (N,): the truth unless said.
    """

    period = 1 / 60
    delay = 0.03

    def __init__(self, rollers: Rollers, position: np.ndarray, seed: int, *,
                 walls: np.ndarray | tuple[()] = (),
                 told: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        self._rng = np.random.default_rng(seed)
        self.world = World(rollers.bodies(position), np.random.default_rng(seed + 1),
                           walls=walls)
        self._rolling = Rolling(math.tau * rollers.step_out / FIELD)
        self._told = (rollers.gain, rollers.phi) if told is None else told
        self._rotation = Rotation(1.0)
        self._orders: deque[tuple[float, FieldCommand]] = deque()
        self._field = np.zeros(3)
        self._t = 0.0

    def run(self, controller: Controller, seconds: float,
            note: Callable[[float, Outcome], bool | None], **what: Any) -> None:
        """Close the loop for `seconds`, or until `note` says so.

        It is called with the time [s] and what came of each frame. `what` is told beside the
        particles: goals, a path.
        """
        manager = ControllerManager(
            {'it': controller}, 'it', deadline=10.0, worker=UnhurriedWorker)
        begun = self._t
        for k in range(round(seconds / self.period)):
            t = begun + k * self.period
            self._advance(t)
            outcome = manager.tick(dataclasses.replace(self._input(t), **what))
            if outcome.command is not None:
                self._orders.append((t + self.delay, outcome.command))
            if note(t, outcome):
                break
        manager.close()

    def _input(self, t: float) -> ControllerInput:
        gain, phi = self._told
        count = len(gain)
        return ControllerInput(
            t, self.period, 0.0, np.arange(count),
            self.world.position + self._rng.normal(0, _SIGMA, (count, 2)),
            np.full(count, _SIGMA), np.full(count, math.nan), gain, phi,
            0.04 * gain, np.full(count, 0.04), Limits(FIELD, 1.0, 50.0), VIEW, self.delay,
            model=Model(FIELD, 'rolling'))

    def _advance(self, until: float) -> None:
        """Let the world live until then under the fields that were ordered."""
        samples = np.arange(self._t, until - _SAMPLE_S / 2, _SAMPLE_S)
        if not len(samples):
            return
        field = np.array([self._sample(t) for t in samples.tolist()])
        self._rolling.take(samples, field, until)
        self.world.advance(until, self._rolling.history(self._t))
        self._t = until

    def _sample(self, t: float) -> np.ndarray:
        """The field (3,) [T] at `t` [s]."""
        while self._orders and self._orders[0][0] <= t:
            self._turn(t, self._orders.popleft()[1])
        if self._rotation.turns:
            self._field = self._rotation.currents(t)
        return self._field

    def _turn(self, t: float, order: FieldCommand) -> None:
        """From now on as ordered: about the axis ẑ × u, about which rollers go along u."""
        strength = math.hypot(*order.field.tolist())
        if not (strength > 0 and order.frequency > 0):
            self._rotation.stop()
            self._field = np.array([*order.field, 0.0])
            return
        u = order.field / strength
        self._rotation.follow(
            Turning(np.zeros(3), strength * np.eye(3), np.array([-u[1], u[0], 0.0]),
                    math.tau * order.frequency, np.array([*u, 0.0])), t, self._field)
