"""A controller in a loop with the fine simulated world: camera noise, delay, frames."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Goals,
    Limits,
    Workspace,
)
from microbot_ros.control.manager import ControllerManager
from microbot_ros.model.model import Model
from microbot_ros.model.physics.particle import Fluid, rotational_drag
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.world import FieldHistory, World

FLUID = Fluid(viscosity=1.245e-3)
FIELD = 5e-3
VIEW = Workspace(np.array([-144e-6, -108e-6]), np.array([144e-6, 108e-6]))
QUICK = 5e-4
"""Alignment time [s] at FIELD where lag plays no part."""


@dataclass
class Loop:
    """Particles of radius 2.3 µm in a world with hidden effects, and a camera on them.

    The controller sees positions `age` [s] old with `sigma` [m] of noise and headings with
    `theta_std` [rad]; what it commands acts `delay` [s] later. φ and speed it is told exactly,
    if `told`.
    """

    position: np.ndarray
    speed: np.ndarray
    phi: np.ndarray
    effects: dict[str, dict[str, Any]] = field(default_factory=dict)
    seed: int = 0
    period: float = 1 / 60
    delay: float = 0.03
    age: float = 0.015
    sigma: float = 5e-8
    theta_std: float = 0.05
    told: bool = True
    model: Model | None = None
    heading: np.ndarray | float = 0.0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        count = len(self.speed)
        radius = np.full(count, 2.3e-6)
        moment = rotational_drag(FLUID, radius) / (QUICK * FIELD)
        body = bodies(FLUID, radius, moment, self.phi, self.position, speed=self.speed,
                      heading=self.heading)
        for name, parameters in self.effects.items():
            inject_effect(body, name, parameters, reference_field=FIELD)
        self.world = World(body, np.random.default_rng(self.seed + 1000))
        self._fields: deque[tuple[float, np.ndarray]] = deque([(-1.0, np.zeros(2))], maxlen=256)
        self._ticks = 0
        self.spent: list[float] = []

    def controller_input(self, t: float, **what: Any) -> ControllerInput:
        """What the controller is told at a tick; the world is moved on to it."""
        self._advance(t - self.age)
        count, rng = len(self.speed), self.rng
        known = np.full(count, 1e-8 if self.told else math.inf)
        seen = ControllerInput(
            t, self.period, self.age, np.arange(count),
            self.world.position + rng.normal(0, self.sigma, (count, 2)),
            np.full(count, self.sigma), self.world.heading + rng.normal(0, self.theta_std, count),
            self.speed if self.told else np.full(count, math.nan),
            self.phi if self.told else np.full(count, math.nan),
            known, known * 1e6, Limits(FIELD, 1.0, 50.0), VIEW, self.delay, model=self.model)
        return dataclasses.replace(seen, **what)

    def run(self, controller: Controller, seconds: float,
            note: Callable[[float], None], **what: Any) -> None:
        """Close the loop for `seconds`; `note(t)` after each tick."""
        compute = controller.compute

        def timed(inputs: ControllerInput) -> FieldCommand:
            begun = time.thread_time()
            try:
                return compute(inputs)
            finally:
                self.spent.append(time.thread_time() - begun)

        controller.compute = timed  # type: ignore[method-assign]
        manager = ControllerManager({'it': controller}, 'it', deadline=10.0)
        for _ in range(round(seconds / self.period)):
            t = self._ticks * self.period
            outcome = manager.tick(self.controller_input(t, **what))
            if outcome.command is not None:
                self._fields.append((t + self.delay, outcome.command.field))
            note(t)
            self._ticks += 1
        manager.close()

    def distance(self, controller: Controller, goal: np.ndarray, seconds: float,
                 judged: float) -> float:
        """Mean distance [m] of the first particle from its `goal` (1, 2) [m].

        In the last `judged` of the `seconds` that the loop is closed.
        """
        distances: list[float] = []

        def note(t: float) -> None:
            if t > seconds - judged:
                distances.append(float(np.hypot(*(self.world.position[:1] - goal)[0])))

        self.run(controller, seconds, note, goals=Goals(goal))
        return float(np.mean(distances))

    def _advance(self, t: float) -> None:
        rows = [row for row in self._fields if row[0] <= t]
        first = len(rows) - 1
        # A hidden delay looks back by up to a second.
        rows = list(self._fields)[max(0, first - 64):]
        self.world.advance(t, FieldHistory(
            np.array([row[0] for row in rows]), np.array([row[1] for row in rows])[:, None]))
