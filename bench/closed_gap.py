"""What a discovered effect is worth at the wheel: one task, steered with and without it.

A session is filmed of a world with a hidden effect; discovery makes a model of it; then the
predictive controller has to do the same task in that world, once with the first-order model and
once with the discovered one.

Steady disturbances are not among the cases: feedback at 60 Hz rejects a drift or a background
field without knowing it (0.3 µm from the goal either way). Nor is what changes slowly, as a
slip of φ: φ is estimated as it is now.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench._closed_loop import FIELD, FLUID, QUICK, Loop
from bench.figure import Figure
from microbot_ros.control.contract import Goals
from microbot_ros.control.predictive import Predictive
from microbot_ros.discovery.discover import discover
from microbot_ros.model.model import Model
from microbot_ros.model.particle import rotational_drag
from microbot_ros.records import Conditions, Session
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.experiment import Camera, perform
from microbot_ros.virtual_rig.hidden import hide
from microbot_ros.virtual_rig.world import World

CASES: dict[str, dict[str, float]] = {
    'alignment_lag': {'tau_s': 0.6},
    'command_delay': {'delay_s': 0.4},
}
SPEED, PHI = np.array([4.2e-6]), np.array([0.8])
SEEDS = 2
_SECONDS, _JUDGED_SECONDS = 30.0, 15.0


def figures() -> list[Figure]:
    """Mean distance from the goal, discovered over first-order model, for each hidden effect."""
    rows = []
    for effect, parameters in CASES.items():
        found = discover([_filmed(effect, parameters)]).model
        assert found.effect(effect) is not None, f'{effect} was not found'
        before, after = (
            np.mean([_error(model, effect, parameters, seed) for seed in range(SEEDS)]) * 1e6
            for model in (Model(FIELD), found))
        rows.append(Figure(
            5, f'hidden {effect}, at a goal: first-order {before:.2f} µm, discovered '
            f'{after:.2f} µm', float(after / before), '×', '< 1', 'the first-order model',
            bool(after < before)))
    return rows


def _filmed(effect: str, parameters: Mapping[str, float]) -> Session:
    """Four particles for a minute of steps in the hidden world."""
    rng = np.random.default_rng(11)
    radius = np.full(4, 2.3e-6)
    moment = rotational_drag(FLUID, radius) / (QUICK * FIELD)
    body = bodies(FLUID, radius, moment, rng.uniform(-np.pi, np.pi, 4),
                  np.array([[-6, -4], [6, -4], [-6, 4], [6, 4]]) * 1e-5,
                  speed=rng.uniform(3.5e-6, 5e-6, 4))
    hide(body, effect, parameters, reference_field=FIELD)
    commands = steps(rng, 60.0, FIELD, dwell=(1.0, 3.0))
    camera = Camera(30.0, exposure=0.5, noise=5e-8, missed=0.02)
    conditions = Conditions(radius=2.3e-6, viscosity=FLUID.viscosity, reference_field=FIELD)
    session, _ = perform(World(body, rng), commands, camera, 60.0, rng, conditions)
    return session


def _error(model: Model, effect: str, parameters: Mapping[str, float], seed: int) -> float:
    """Mean distance [m] from a goal 25 µm away once there was time to reach it."""
    loop = Loop(np.zeros((1, 2)), SPEED, PHI, {effect: dict(parameters)}, seed=seed, model=model)
    goal = 25e-6 * np.array([[np.cos(seed), np.sin(seed)]])
    distances: list[float] = []

    def note(t: float) -> None:
        if t > _SECONDS - _JUDGED_SECONDS:
            distances.append(float(np.hypot(*(loop.world.position - goal)[0])))

    loop.run(Predictive(), _SECONDS, note, goals=Goals(goal))
    return float(np.mean(distances))
