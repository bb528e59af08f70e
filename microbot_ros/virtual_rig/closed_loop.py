"""Simulated world steered by the loop, frame by frame, as fast as the machine allows."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np

from microbot_ros.common import settings
from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Session, Tracks
from microbot_ros.control.contract import Controller, Goals
from microbot_ros.control.registry import PluginError, controller_class
from microbot_ros.loop.allocation import GateParameters
from microbot_ros.loop.controller import ControllerParameters
from microbot_ros.loop.loop import Loop, LoopParameters, LoopStep
from microbot_ros.loop.model import ModelParameters
from microbot_ros.loop.points import particles_at
from microbot_ros.loop.tracker import TrackerParameters
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings
from microbot_ros.virtual_rig.record_session import in_picture
from microbot_ros.virtual_rig.scenario import ControllerSettings, Scenario
from microbot_ros.virtual_rig.world import FieldHistory, World

_log = logging.getLogger(__name__)

_KEPT_S = 2.0
"""Choice: fields of this time [s] are kept, more than the longest delay of an effect."""


class LoopFeedback:
    """An armed `loop` as feedback law: the positions of a frame are its particles.

    `noise` [m] is the standard deviation of each coordinate given to the loop. The amplifier is
    ideal: it reads back the command at once.

    Parameters
    ----------
    loop : Loop
        The loop.
    noise : float
        Standard deviation of each coordinate [m].
    """

    def __init__(self, loop: Loop, noise: float) -> None:
        self._noise = noise
        self.loop = _armed(loop)

    def __call__(self, t: float, seen: np.ndarray) -> np.ndarray:
        """Return the field (2,) [T] after a frame at `t` [s] with positions `seen` (N, 2) [m]."""
        rows = np.flatnonzero(np.isfinite(seen).all(axis=1))
        particles = particles_at(rows, seen[rows], self._noise)
        return self.loop.measured(self.loop.steer(particles, t).currents, t)


def make_feedback(scenario: Scenario, source: str) -> LoopFeedback:
    """Return the loop with the `controller` of a `scenario`.

    Raises InputError naming `source` if that is impossible.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    source : str
        Name of the scenario, for messages.

    Returns
    -------
    LoopFeedback
        The loop.
    """
    return LoopFeedback(_make_loop(scenario, source), scenario.camera.localisation_um * 1e-6)


def film(scenario: Scenario, world: World, source: str) -> Session:
    """Steer a `world` by its pictures with the `controller` of a `scenario`.

    The session holds the tracks of the loop's tracker. Raises InputError naming `source` if the
    loop is impossible.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    world : World
        The world.
    source : str
        Name of the scenario, for messages.

    Returns
    -------
    Session
        The session.
    """
    loop = _armed(_make_loop(scenario, source))
    view = MicroscopeSettings(radius_um=scenario.radius_um)
    microscope = Microscope(view, scenario.seed)
    rate = scenario.camera.frame_rate_hz
    rows: list[tuple[float, np.ndarray]] = []
    steps: list[LoopStep] = []
    for t in (np.arange(math.floor(scenario.duration_s * rate) + 1) / rate).tolist():
        world.advance(t, _history(rows, t))
        steps.append(loop.step(microscope.render(in_picture(world), world.heading, t), t))
        rows.append((t, loop.measured(steps[-1].currents, t)))
    tell_fault(loop, source)
    commands = Commands(np.array([t for t, _ in rows]), np.array([field for _, field in rows]))
    return Session(_tracks(steps), commands, scenario.conditions)


def tell_fault(loop: Loop, source: str) -> None:
    """Log a warning if the gate of `loop` cut the currents in the scenario `source`.

    Parameters
    ----------
    loop : Loop
        The loop.
    source : str
        Name of the scenario, for messages.
    """
    if fault := loop.gate.fault:
        _log.warning('%s: the gate cut the currents, %s: %s', source, fault.reason.value,
                     fault.detail)


def _make_loop(scenario: Scenario, source: str) -> Loop:
    wanted = scenario.controller
    assert wanted is not None
    gate = GateParameters(full_field_mT=wanted.max_field_mT)
    slowest = 1e3 / gate.command_timeout_ms
    if not scenario.camera.frame_rate_hz > slowest:
        raise InputError(source, f"'camera.frame_rate_hz': expected more than {slowest:.3g} "
                                 'with a controller, as commands expire after one period of '
                                 'that rate')
    try:
        own = _parameters(controller_class(wanted.name), wanted)
        loop = Loop(LoopParameters(
            TrackerParameters(pixel_size_um=MicroscopeSettings().pixel_size_um),
            ModelParameters(radius_um=scenario.radius_um,
                            viscosity_mPa_s=scenario.fluid.viscosity_mPa_s,
                            temperature_K=scenario.fluid.temperature_K,
                            height_um=scenario.height_um or 0.0,
                            reference_field_mT=scenario.reference_field_mT),
            ControllerParameters(controller=wanted.name, max_field_mT=wanted.max_field_mT),
            gate, {wanted.name: own}))
    except (PluginError, ValueError) as error:
        raise InputError(source, f"'controller': {error}") from None
    loop.controller.go_to(Goals(np.array(wanted.goals_um).reshape(-1, 2) * 1e-6))
    loop.controller.follow(np.array(wanted.path_um).reshape(-1, 2) * 1e-6)
    return loop


def _parameters(controller: type[Controller], wanted: ControllerSettings) -> Any:
    kind = controller.Parameters
    known = settings.defaults(kind)
    if unknown := wanted.parameters.keys() - known.keys():
        raise ValueError(f'unknown parameter {min(unknown)!r} of {wanted.name}; expected one of '
                         f'{", ".join(sorted(known)) or "none"}')
    return kind(**known | {name: settings.convert(kind, name, value)
                           for name, value in wanted.parameters.items()})


def _armed(loop: Loop) -> Loop:
    loop.measured(np.zeros(4), 0.0)
    loop.arm(0.0)
    return loop


def _history(rows: list[tuple[float, np.ndarray]], now: float) -> FieldHistory:
    first = len(rows)
    while first > 0 and rows[first - 1][0] > now - _KEPT_S:
        first -= 1
    recent = rows[max(first - 1, 0):]
    return FieldHistory(np.array([t for t, _ in recent]),
                        np.array([field for _, field in recent]).reshape(-1, 1, 2))


def _tracks(steps: list[LoopStep]) -> Tracks:
    seen = np.concatenate([step.particles for step in steps])
    t = np.repeat([step.t for step in steps], [len(step.particles) for step in steps])
    place = np.stack([seen['x'], seen['y']], axis=1).astype(float)
    return Tracks(t, seen['id'].astype(int), place, seen['theta'].astype(float),
                  seen['sigma'].astype(float))
