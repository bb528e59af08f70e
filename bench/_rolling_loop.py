"""Rollers driven by a controller, without ROS: fields sample by sample, moments that slip.

The physics is finer than what any controller knows: the field rotates as the driver makes it, the
moment of each roller follows in three dimensions as far as it can (`rolling`), and the `World`
moves the rollers, with Brownian motion and contact.
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
"""Choice: field [T] for which step-out frequencies are stated, the default of the rig."""
# The default workspace of the controller node.
VIEW = Workspace(np.array([-140e-6, -104e-6]), np.array([140e-6, 104e-6]))
FLUID = Fluid(viscosity=1e-3, height=2.6e-6)
"""Choice: water; spheres of 2.3 µm roll 0.3 µm above the floor."""
# Choices: step of the field [s], localisation error [m], alignment time of the bodies [s].
_SAMPLE_S, _SIGMA, _QUICK_S = 1e-3, 5e-8, 5e-4


@dataclass(frozen=True)
class Rollers:
    """Properties of N rollers.

    `gain` (N,) [m per turn], `phi` (N,) [rad], `step_out` (N,) [Hz] at `FIELD`, `radius` (N,) [m].
    A roller with a gain of 0 is a bead, which no field moves.
    """

    gain: np.ndarray
    phi: np.ndarray
    step_out: np.ndarray
    radius: np.ndarray

    def bodies(self, position: np.ndarray) -> np.ndarray:
        """Return bodies at `position` (N, 2) [m]; their rotation stirs the water."""
        moment = rotational_drag(FLUID, self.radius) / (_QUICK_S * FIELD)
        made = bodies(FLUID, self.radius, moment, self.phi, position, gain=self.gain)
        made['stir'] = np.where(self.gain > 0, stirring(self.radius), 0.0)
        return made


def stirring(radius: np.ndarray) -> np.ndarray:
    """Return `BODY.stir` (N,) [m⁴ per turn] of spheres of `radius` (N,) [m] on the floor.

    The far flow of a torque 8πηa³ω along a floor at the height h, at that height, is 6ωa³h cos
    ϑ/r³ outward (Blake and Chwang, Journal of Engineering Mathematics 8, 23 (1974)).
    """
    return np.asarray(6 * math.tau * radius**3 * (FLUID.height or 0.0))


class RollingLoop:
    """World of rollers with a camera and a controller.

    The controller gets positions every `period` [s], with 50 nm of noise; its commands act `delay`
    [s] later.

    Parameters
    ----------
    rollers : Rollers
    position : (N, 2) array [m]
    seed : int
    walls : (W, 4) array [m]
        As in `World`.
    told : tuple of two (N,) arrays, optional
        Gain [m per turn] and φ [rad] given to the controller; by default the truth.
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
        """Close the loop with a `controller` for `seconds`, or until `note` returns True.

        `note` is called with the time [s] and the outcome of each frame. `what` are further
        inputs: goals, a path.
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
        """Advance the world under the ordered fields."""
        samples = np.arange(self._t, until - _SAMPLE_S / 2, _SAMPLE_S)
        if not len(samples):
            return
        field = np.array([self._sample(t) for t in samples.tolist()])
        self._rolling.take(samples, field, until)
        self.world.advance(until, self._rolling.history(self._t))
        self._t = until

    def _sample(self, t: float) -> np.ndarray:
        """Return the field (3,) [T] at `t` [s]."""
        while self._orders and self._orders[0][0] <= t:
            self._turn(t, self._orders.popleft()[1])
        if self._rotation.turns:
            self._field = self._rotation.currents(t)
        return self._field

    def _turn(self, t: float, order: FieldCommand) -> None:
        """Start an ordered rotation about ẑ × u, which rolls particles along u."""
        strength = math.hypot(*order.field.tolist())
        if not (strength > 0 and order.frequency > 0):
            self._rotation.stop()
            self._field = np.array([*order.field, 0.0])
            return
        u = order.field / strength
        self._rotation.follow(
            Turning(np.zeros(3), strength * np.eye(3), np.array([-u[1], u[0], 0.0]),
                    math.tau * order.frequency, np.array([*u, 0.0])), t, self._field)
