"""The loop as a function: the same currents for the same frames, and none that the gate denies."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from coil_rigs import EIGHT, SIX

from microbot_ros.control.contract import FieldCommand, Goals
from microbot_ros.control.manager import Outcome
from microbot_ros.drive.gate import Reason
from microbot_ros.loop.allocation import GateParameters
from microbot_ros.loop.controller import ControllerParameters
from microbot_ros.loop.loop import Loop, LoopParameters, LoopStep
from microbot_ros.loop.model import ModelParameters
from microbot_ros.loop.points import particles_at
from microbot_ros.loop.tracker import TrackerParameters
from microbot_ros.magnetics import CoilSettings
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.io.model_file import write_model
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.tracking import FrameError
from microbot_ros.virtual_rig.closed_loop import LoopFeedback
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

WATER = Fluid(1.245e-3)
RADIUS = 2.3e-6
GOAL = np.array([[30e-6, -20e-6]])
WIDE = {'current_limit_A': 100.0, 'step_limit_A': 200.0, 'slew_limit_A_per_s': 1e4}
"""Limits that the coils of every rig here keep."""


def loop(controller: str = 'waypoint', **gate: Any) -> Loop:
    made = Loop(LoopParameters(
        TrackerParameters(pixel_size_um=0.45),
        ModelParameters(radius_um=RADIUS * 1e6, viscosity_mPa_s=WATER.viscosity * 1e3),
        ControllerParameters(controller=controller), GateParameters(**gate)))
    made.controller.go_to(Goals(GOAL))
    return made


def world(seed: int, count: int = 1) -> World:
    rng = np.random.default_rng(seed)
    return World(draw_swarm(rng, count, WATER, 5e-3, radius=RADIUS, half_extent=60e-6), rng)


def steered(seed: int, seconds: float) -> tuple[np.ndarray, list[LoopStep]]:
    """The last place (2,) [m] of a particle that has a goal, and every step."""
    made, steps = loop(), list[LoopStep]()
    feedback, steer = LoopFeedback(made, 0.1e-6), made.steer

    def noted(seen: np.ndarray, t: float) -> LoopStep:
        steps.append(steer(seen, t))
        return steps[-1]

    made.steer = noted  # type: ignore[method-assign]
    _, path = record_session(world(seed), feedback, Camera(30.0, noise=0.1e-6), seconds,
                             np.random.default_rng(seed))
    return path.position[-1, 0], steps


def armed(made: Loop) -> Loop:
    made.measured(np.zeros(4), 0.0)
    made.arm(0.0)
    return made


def particles(*places: tuple[float, float]) -> np.ndarray:
    return particles_at(np.arange(len(places)), np.array(places), 1e-7)


def test_a_particle_is_brought_to_its_goal() -> None:
    place, steps = steered(seed=4, seconds=30.0)
    assert np.hypot(*(place - GOAL[0])) < 3e-6
    assert any(np.any(step.currents) for step in steps)


def test_the_same_frames_give_the_same_currents_to_the_last_bit() -> None:
    first, second = (steered(seed=5, seconds=6.0)[1] for _ in range(2))
    assert len(first) == len(second) > 100
    for one, other in zip(first, second, strict=True):
        assert one.currents.tobytes() == other.currents.tobytes()
        assert one.estimates.tobytes() == other.estimates.tobytes()
        assert one.reasons == other.reasons


def test_the_order_of_particles_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    straight, turned = armed(loop()), armed(loop())
    for k in range(60):
        t = (k + 1) / 30
        seen = particles((1e-6 * t, 0.0), (2e-5, 1e-6 * rng.normal()), (-3e-5, 1e-6 * t))
        one, other = straight.steer(seen, t), turned.steer(seen[::-1].copy(), t)
        assert one.currents.tobytes() == other.currents.tobytes()
        for each in (straight, turned):
            each.measured(one.currents, t)


def test_nothing_flows_before_it_is_armed_and_the_reason_is_told() -> None:
    made = loop()
    step = made.steer(particles((0.0, 0.0)), 0.1)
    assert not step.currents.any()
    with pytest.raises(RuntimeError, match='no measured currents'):
        made.arm(0.1)


def test_what_the_amplifier_reads_back_is_judged() -> None:
    made = armed(loop())
    made.steer(particles((0.0, 0.0)), 0.03)
    made.measured(np.array([1.0, 0.0, 0.0, 0.0]), 0.2)
    step = made.steer(particles((0.0, 0.0)), 0.23)
    assert not step.currents.any()
    assert any(reason.startswith(Reason.DEVIATION.value) for reason in step.reasons)


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf])
def test_places_that_are_no_numbers_command_nothing(value: float) -> None:
    made = armed(loop())
    for k in range(30):
        t = (k + 1) / 30
        step = made.steer(particles((value, 0.0)), t)
        made.measured(step.currents, t)
        assert not step.currents.any()
        assert np.isfinite(step.field).all()


def test_a_gap_in_the_frames_lets_the_field_go() -> None:
    made = armed(loop('open_loop'))
    flowing = [made.steer(particles((0.0, 0.0)), k / 30) for k in range(1, 4)]
    assert any(step.currents.any() for step in flowing)
    step = made.steer(particles((0.0, 0.0)), 1.0)
    assert not step.currents.any()
    assert any(reason.startswith((Reason.STALE.value, Reason.SILENCE.value))
               for reason in step.reasons)


def test_a_picture_that_cannot_be_used_is_refused_and_changes_nothing() -> None:
    made = armed(loop())
    made.step(np.full((240, 320), 128, np.uint8), 1 / 30)
    with pytest.raises(FrameError):
        made.step(np.zeros((100, 100), np.uint8), 2 / 30)
    assert made.tracker.frames == 1
    assert made.tracker.refused == 1


def turned(angular_velocity: np.ndarray, field: np.ndarray) -> Outcome:
    """What a controller asks for that turns a field (2,) or (3,) [T], right-handed."""
    rate = float(np.linalg.norm(angular_velocity))
    return Outcome(FieldCommand(field, rate / math.tau, axis=angular_velocity / rate))


def asking(made: Loop, outcome: Outcome) -> Loop:
    """A loop whose controller answers one thing."""
    made.controller.step = lambda *_: outcome  # type: ignore[method-assign]
    channels = len(made.allocation.coils.names)
    made.measured(np.zeros(channels), 0.0)
    made.arm(0.0)
    return made


def coils(folder: Path, found: CoilSettings) -> str:
    file = folder / 'coils.yaml'
    file.write_text(yaml.safe_dump(found.content()))
    return str(file)


@pytest.mark.parametrize('settings', [SIX, EIGHT])
def test_coils_of_three_axes_make_a_field_that_stands_up(
        tmp_path: Path, settings: CoilSettings) -> None:
    wanted = np.array([0.5e-3, -0.3e-3, 0.8e-3])
    made = asking(loop(coils_file=coils(tmp_path, settings), full_field_mT=1.0, **WIDE),
                  Outcome(FieldCommand(wanted)))
    step = made.steer(particles((0.0, 0.0)), 0.03)
    assert len(step.currents) == len(settings.windings)
    assert made.measured(step.currents, 0.031) == pytest.approx(wanted, abs=1e-9)


def test_what_the_coils_cannot_make_is_not_commanded_and_told() -> None:
    made = asking(loop(), Outcome(FieldCommand(np.array([0.0, 0.0, 1e-3]))))
    step = made.steer(particles((0.0, 0.0)), 0.03)
    assert not step.currents.any()
    assert any('no field along z' in reason for reason in step.reasons)


@pytest.mark.parametrize('axis', [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_a_field_turns_between_frames_about_its_axis(
        tmp_path: Path, axis: tuple[float, float, float]) -> None:
    omega = math.tau * 5 * np.array(axis)
    across = np.array([0.0, 1e-3, 0.0])
    made = asking(loop(coils_file=coils(tmp_path, SIX), full_field_mT=1.0, **WIDE),
                  turned(omega, across))
    made.steer(particles((0.0, 0.0)), 0.03)
    for t in np.arange(0.031, 0.1, 0.001):
        field = made.measured(made.sample(float(t)), float(t))
        angle = np.linalg.norm(omega) * (t - 0.03)
        turn = np.cross(np.array(axis), across)
        settled = t > 0.06  # the first field is reached no faster than the slew limit allows
        if settled:
            assert field == pytest.approx(
                math.cos(angle) * across + math.sin(angle) * turn, abs=2e-5)


def test_a_field_that_turned_stops_with_the_next_that_stands_and_goes_stale_alone() -> None:
    made = asking(loop(), turned(math.tau * np.array([0.0, 0.0, 5.0]), np.array([1e-3, 0.0])))
    made.steer(particles((0.0, 0.0)), 0.03)
    assert made.sample(0.05).any()
    assert not made.sample(0.2).any()
    assert made.gate.fault is not None
    assert made.gate.fault.reason in (Reason.STALE, Reason.SILENCE)
    assert not made.sample(0.21).any()


def test_rollers_are_learned_by_what_turns() -> None:
    made = Loop(LoopParameters(model=ModelParameters(propulsion='rolling')))
    told: list[tuple[float, list[float]]] = []
    made.model.rotation = lambda t, omega: told.append(  # type: ignore[method-assign]
        (t, omega.tolist()))
    omega = np.array([0.0, math.tau * 5, 0.0])
    made.controller.step = lambda *_: turned(  # type: ignore[method-assign]
        omega, np.array([1e-3, 0.0]))
    made.steer(particles((0.0, 0.0)), 0.1)
    made.controller.step = lambda *_: Outcome(None)  # type: ignore[method-assign]
    made.steer(particles((0.0, 0.0)), 0.2)
    made.steer(particles((0.0, 0.0)), 0.3)
    assert told == [(0.1, omega[:2].tolist()), (0.2, [0.0, 0.0])]


def test_rollers_are_learned_by_what_flows() -> None:
    """A field that is asked for and does not flow turns nothing."""
    made = asking(Loop(LoopParameters(model=ModelParameters(propulsion='rolling'))),
                  turned(np.array([0.0, math.tau * 5, 0.0]), np.array([1e-3, 0.0])))
    told: list[tuple[float, bool]] = []
    stands = lambda t, omega: told.append((t, omega.any()))  # noqa: E731
    made.model.rotation = made.tracker.rotation = stands  # type: ignore[method-assign]
    made.model.field = stands  # type: ignore[method-assign]
    made.measured(np.array([1.0, 0.0, -1.0, 0.0]), 0.05)
    made.steer(particles((0.0, 0.0)), 0.1)
    made.measured(np.array([1.0, 0.0, -1.0, 0.0]), 0.11)
    made.measured(np.zeros(4), 0.12)
    assert told == [(t, flows) for t, flows in ((0.05, False), (0.1, True), (0.12, False))
                    for _ in range(2)]


def test_model_and_tracker_are_told_the_field_that_is_read_back(tmp_path: Path) -> None:
    made = loop(coils_file=coils(tmp_path, SIX), full_field_mT=1.0, **WIDE)
    told: list[tuple[float, list[float]]] = []
    take = lambda t, field: told.append((t, field.tolist()))  # noqa: E731
    made.model.field = take  # type: ignore[method-assign]
    currents = made.allocation.step(np.array([1e-3, 0.5e-3, 0.2e-3]))
    field = made.measured(currents, 0.01)  # before there is a tracker
    made.tracker.field = take  # type: ignore[method-assign]
    made.measured(currents, 0.02)
    assert told == [(t, field[:2].tolist()) for t in (0.01, 0.02, 0.02)]


def test_the_model_of_a_file_is_used_from_the_first_frame_on(tmp_path: Path) -> None:
    file = tmp_path / 'model.yaml'
    write_model(file, Model(5e-3).with_effect(CommandDelay(0.2)),
                ParticleParameters(np.arange(1), np.zeros(1), np.zeros(1)))
    made = Loop(LoopParameters(model=ModelParameters(model_file=str(file))))
    assert made.model.estimator.model.effects == (CommandDelay(0.2),)


@pytest.mark.parametrize('commands', [True, False])
def test_a_controller_lets_go_where_it_commands_nothing(commands: bool) -> None:
    field = FieldCommand(np.array([1e-3, 0.0]))
    made, gone = asking(loop(), Outcome(field if commands else None)), []
    made.controller.let_go = lambda: gone.append(True)  # type: ignore[method-assign]
    made.steer(particles((0.0, 0.0)), 0.03)
    assert bool(gone) != commands
