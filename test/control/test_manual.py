"""A field by hand, in the terms of laboratories, as the node would publish it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.control.contract import FieldCommand, Limits
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.manual import Manual, ManualParameters
from microbot_ros.control.testkit import controller_input
from microbot_ros.loop.allocation import AllocationStage, GateParameters

LIMITS = Limits(field=10e-3, slew=1e6, frequency=40.0)


def answer(**values: float) -> FieldCommand:
    controller = Manual()
    controller.configure(ManualParameters(**values))
    return controller.compute(controller_input(limits=LIMITS))


@given(alpha=st.floats(-360, 360), gamma=st.floats(0, 180), psi=st.floats(0, 90))
def test_a_cone_about_its_axis(alpha, gamma, psi):
    """As its definition says: the angle to the axis, the strength, the axis' own angles."""
    command = answer(field_mT=4, alpha_deg=alpha, gamma_deg=gamma, psi_deg=psi, frequency_hz=3)
    omega, field = command.angular_velocity, command.field
    assert np.linalg.norm(omega) == pytest.approx(math.tau * 3)
    assert np.linalg.norm(field) == pytest.approx(4e-3)
    assert field @ omega / np.linalg.norm(omega) == pytest.approx(
        4e-3 * math.cos(math.radians(psi)), abs=1e-15)
    assert omega[2] == pytest.approx(math.tau * 3 * math.cos(math.radians(gamma)), abs=1e-12)


def test_at_rest_it_stands_along_the_axis():
    up = answer(field_mT=2, gamma_deg=0)
    np.testing.assert_allclose(up.field, [0, 0, 2e-3], atol=1e-18)
    assert not up.angular_velocity.any()
    aside = answer(field_mT=2, alpha_deg=90)
    np.testing.assert_allclose(aside.field, [0, 2e-3, 0], atol=1e-18)


def test_what_rolls_heads_for_alpha_less_90_degrees():
    """ω̂ × ẑ, as in `docs/how-to/rollers.md`; a field whose axis stands upright rolls nothing."""
    command = answer(field_mT=2, alpha_deg=70, frequency_hz=5)
    heading = np.cross(command.angular_velocity, [0, 0, 1])[:2]
    assert math.degrees(math.atan2(heading[1], heading[0])) == pytest.approx(-20)
    np.testing.assert_allclose(command.drive / 2e-3, heading / np.linalg.norm(heading))
    assert np.linalg.norm(answer(field_mT=2, gamma_deg=0, frequency_hz=5).drive) < 1e-18


def test_limits_hold_for_the_whole_vector():
    command = answer(field_mT=100, gamma_deg=30, frequency_hz=1000)
    assert np.linalg.norm(command.field) == pytest.approx(LIMITS.field)
    assert command.frequency == LIMITS.frequency


class Answers(Manual):
    """Whatever it is given."""

    def __init__(self, command: FieldCommand) -> None:
        super().__init__()
        self.command = command

    def compute(self, inputs):
        return self.command


def asked(command: FieldCommand, **inputs: object) -> tuple[FieldCommand | None, str]:
    manager = ControllerManager({'it': Answers(command)}, 'it', deadline=5.0)
    outcome = manager.tick(controller_input(limits=LIMITS, **inputs))
    manager.close()
    return outcome.command, outcome.message


@pytest.mark.parametrize('command', [
    FieldCommand(np.array([0.0, 0.0, math.nan])), FieldCommand(np.array([0.0, 0.0, math.inf])),
    FieldCommand(np.array([8e-3, 0.0, 8e-3])), FieldCommand(np.zeros(4)),
    FieldCommand(np.array([1e-3, 0, 0]), 1.0, axis=np.array([0.0, math.nan, 0.0])),
    FieldCommand(np.array([1e-3, 0, 0]), 1.0, axis=np.array([math.inf, 0.0, 0.0])),
    FieldCommand(np.array([1e-3, 0, 0]), 1.0, axis=np.zeros(3)),
    FieldCommand(np.array([1e-3, 0, 0]), 1.0, axis=np.ones(2))])
def test_the_manager_lets_none_pass_that_is_no_field(command):
    sent, message = asked(command)
    assert sent is not None
    assert not sent.field.any()
    assert sent.frequency == 0
    assert message


def test_the_slew_counts_the_part_along_z():
    up = FieldCommand(np.array([0.0, 0.0, 5e-3]))
    manager = ControllerManager({'it': Answers(up)}, 'it', deadline=5.0)
    slow = dataclasses.replace(LIMITS, slew=0.1)
    strengths = []
    for k in range(7):
        outcome = manager.tick(controller_input(t=k * 0.01, dt=0.01, limits=slow))
        strengths.append(np.linalg.norm(outcome.command.field))
    manager.close()
    np.testing.assert_allclose(np.diff([0, *strengths]), [1e-3] * 5 + [0, 0], atol=1e-12)


def test_four_coils_in_a_plane_refuse_what_points_out_of_it():
    stage = AllocationStage(GateParameters())
    with pytest.raises(ValueError, match='no field along z'):
        stage.step(answer(field_mT=2, gamma_deg=45).field)
    tilted = answer(field_mT=2, gamma_deg=45, frequency_hz=2)
    with pytest.raises(ValueError, match='along z'):
        stage.turn(tilted.field, tilted.angular_velocity)
    disc = answer(field_mT=2, gamma_deg=0, frequency_hz=2)
    turning = stage.turn(disc.field, disc.angular_velocity)
    quarter = np.linalg.norm(stage.field(turning.at(np.array([1.0, 0, 0]))))
    assert quarter == pytest.approx(2e-3)
