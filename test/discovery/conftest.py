"""Blind sessions from the Langevin physics, never from the equations that are fitted."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.common.records import Conditions, Session
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

FLUID = Fluid(1.245e-3)
FIELD = 5e-3
RADIUS = 4.6e-6


def film(seed, effects=None, count=3, duration=30.0, camera=Camera(20.0, 0.0, 0.1e-6),  # noqa: B008
         levels=FIELD, dwell=(1.0, 3.0), rolling=False, half_extent=100e-6):
    """A session with hidden effects, and the particles with their true v and φ."""
    rng = np.random.default_rng(seed)
    made = draw_swarm(rng, count, FLUID, FIELD, aligns_in=2e-5, half_extent=half_extent,
                      spacing=30e-6)
    frequency = None
    if rolling:
        made['gain'], made['speed'] = rng.uniform(1e-6, 2e-6, count), 0.0
        frequency = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
    for name, parameters in (effects or {}).items():
        inject_effect(made, name, parameters, FIELD)
    truth = made.copy()
    known = Conditions('rolling' if rolling else 'catalytic', radius=RADIUS,
                       viscosity=FLUID.viscosity, reference_field=FIELD)
    command = steps(rng, duration, levels, dwell, frequency=frequency)
    session, _ = record_session(World(made, rng), command, camera, duration, rng, known)
    return Session(session.tracks, session.commands, session.conditions, f'film-{seed}'), truth


@pytest.fixture(name='film', scope='session')
def film_fixture():
    return film
