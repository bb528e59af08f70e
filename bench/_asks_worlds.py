"""Worlds to be asked: effects hidden at so much evidence a minute of random steps."""

from __future__ import annotations

import math

import numpy as np

from bench._driven_rig import SimulatedRig
from bench._hidden_effects import KINDS, Hideout, Parameters
from bench._hidden_suite import ABOVE_FLOOR, FIELD, FLUID, Experiment, Yardstick, is_near_floor
from microbot_ros.common.records import Conditions
from microbot_ros.control.contract import Workspace
from microbot_ros.discovery.driven.design import Range, random_steps
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm
from microbot_ros.virtual_rig.world import World

MINUTE = 60.0
FREQUENCY = (1.0, 20.0)
PASSING, LASTING = ('lamp_change', 'stage_jump', 'settling_flow'), 6.0
"""What happens once in the first minute, and has no more evidence after: it is given that of so
many minutes."""


def hidden_world(seed: int, effects: tuple[str, ...], evidence: float = 10.0,
                 ) -> tuple[SimulatedRig, dict[str, Parameters]]:
    """A rig drawn by `seed`, and what is hidden in it: `effects` of that `evidence` λ each.

    A minute of random steps would hold so much, and of what is PASSING as much as LASTING minutes
    of what is not. Near the floor of the instrument, where it must not be named, it is given more.
    Where the strongest that a rig may have holds less, another one is drawn.
    """
    for attempt in range(200):
        rng = np.random.default_rng([seed, attempt, 18])
        experiment, extent = _draw(rng, effects)
        plan = experiment.control()
        _, path = experiment.film({})
        if not experiment.apart(path):
            continue
        yardstick = Yardstick(experiment, plan, path)
        hidden: dict[str, Parameters] = {}
        for effect in effects:
            shaped = KINDS[effect].shaped(Hideout(rng, extent * 1e6, MINUTE))
            wanted = evidence * (LASTING if effect in PASSING else 1.0)
            strength = yardstick.strength(effect, shaped, wanted)
            while strength is not None and is_near_floor(effect, shaped(strength)):
                wanted *= ABOVE_FLOOR**2
                strength = yardstick.strength(effect, shaped, wanted)
            if strength is None:
                break
            hidden[effect] = shaped(strength)
        if len(hidden) == len(effects):
            return _rig(experiment, hidden, seed), hidden
    raise RuntimeError(f'seed {seed}: {effects} can’t be hidden')


def _rig(experiment: Experiment, hidden: dict[str, Parameters], seed: int) -> SimulatedRig:
    swarm, rng = experiment.swarm.copy(), np.random.default_rng([seed, 19])
    for effect, parameters in hidden.items():
        inject_effect(swarm, effect, parameters, FIELD)
    rolling = experiment.conditions.propulsion == 'rolling'
    return SimulatedRig(World(swarm, rng), experiment.camera, experiment.conditions, FIELD, rng,
                        FREQUENCY if rolling else None)


def _draw(rng: np.random.Generator, effects: tuple[str, ...]) -> tuple[Experiment, float]:
    pairs = any(KINDS[effect].pairs for effect in effects)
    rolling = 'drive_response' in effects
    count = 7 if pairs else 4
    radius = 2.5e-6
    extent = (9 * radius if pairs else 25e-6) * math.sqrt(count)
    swarm = draw_swarm(rng, count, FLUID, FIELD, radius=radius, half_extent=extent,
                       spacing=7 * radius if pairs else 20e-6, aligns_in=5e-5)
    if pairs:  # alike, so that they stay near each other without touching
        swarm['phi'] = swarm['phi'][0] + rng.uniform(-0.3, 0.3, count)
    if rolling:
        swarm['gain'], swarm['speed'] = swarm['speed'] / 8, 0.0
    camera = Camera(20.0, 0.5, 0.1e-6, missed=0.05, run=3.0, dropped=0.02)
    conditions = Conditions(propulsion='rolling' if rolling else 'catalytic', radius=radius,
                            viscosity=FLUID.viscosity, reference_field=FIELD)
    view = Workspace(np.full(2, -np.inf), np.full(2, np.inf))
    legs = random_steps(rng, MINUTE, Range(FIELD, view, FREQUENCY if rolling else None))
    commands = legs.commands()
    return Experiment(swarm, lambda: commands, camera, MINUTE, conditions,
                      int(rng.integers(2**31))), extent


