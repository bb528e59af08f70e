"""Filmed swimmers of the virtual rig, for tests of what is estimated from their tracks."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

FIELD = 5e-3
CONDITIONS = Conditions(radius=4.6e-6, viscosity=1.245e-3, reference_field=FIELD)


def swimmers(
        seed: int, seconds: float, camera: Camera, *, phi: np.ndarray | None = None,
        spacing: float = 100e-6, dwell: tuple[float, float] = (2.0, 6.0),
        commands: Commands | None = None, known: Conditions = CONDITIONS,
        height: float | None = None, hidden: tuple[str, Mapping[str, float]] | None = None,
) -> tuple[Session, np.ndarray]:
    """A session of three swimmers far apart, or one for each `phi`, and their true v·e^{iφ}.

    A floor at a `height` and a `hidden` effect act on them, whatever is `known` of the conditions.
    """
    rng = np.random.default_rng(seed)
    swarm = draw_swarm(rng, 3 if phi is None else len(phi), Fluid(1.245e-3, height=height), FIELD,
                       half_extent=300e-6, spacing=spacing)
    if phi is not None:
        swarm['phi'] = phi
    gain = swarm['speed'] * np.exp(1j * swarm['phi'])
    if hidden:
        inject_effect(swarm, *hidden, reference_field=FIELD)
    commands = commands or steps(rng, seconds, FIELD, dwell)
    session, _ = record_session(World(swarm, rng), commands, camera, seconds, rng, known)
    return session, gain
