"""A field by hand, in the terms of laboratories, as the node would publish it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.control.contract import FieldCommand, Limits
from microbot_ros.control.plugins.manual import Manual, ManualParameters
from microbot_ros.control.testkit import controller_input

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
