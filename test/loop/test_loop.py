"""The loop as a function: the same currents for the same frames, and none that the gate denies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from microbot_ros.control.contract import Goals
from microbot_ros.drive.gate import Reason
from microbot_ros.loop.allocation import GateParameters
from microbot_ros.loop.controller import ControllerParameters
from microbot_ros.loop.loop import Loop, LoopParameters, LoopStep
from microbot_ros.loop.model import ModelParameters
from microbot_ros.loop.points import particles_at
from microbot_ros.loop.tracker import TrackerParameters
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.tracking import FrameError
from microbot_ros.virtual_rig.closed_loop import LoopFeedback
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

WATER = Fluid(1.245e-3)
RADIUS = 2.3e-6
GOAL = np.array([[30e-6, -20e-6]])


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
