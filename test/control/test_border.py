"""What is driven stays in view, whichever controller drives: the barrier and what it costs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.control.contract import FieldCommand, Result
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.open_loop import OpenLoop, OpenLoopParameters
from microbot_ros.control.plugins.teleop import Teleop, TeleopParameters
from microbot_ros.control.steering.border import kept_in_view
from microbot_ros.control.testkit import VIEW, controller_input
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.model import Model

HORIZON = 0.5
EAST = FieldCommand(np.array([5e-3, 0.0]))


def place(x_um, y_um=0.0, **changes):
    """One particle with φ = 0, 4 µm/s."""
    at = np.array([[x_um, y_um]]) * 1e-6
    known = {'speed': np.array([4e-6]), 'phi': np.zeros(1)}
    return controller_input(1, position=at, expected=at, **known | changes)


def test_far_from_the_border_nothing_is_changed():
    assert kept_in_view(place(141.9), EAST, HORIZON) is EAST


def test_near_the_border_the_course_is_turned_by_the_least():
    """1 µm off the border and half a second: 2 of 4 µm/s may lead outwards, so 60°."""
    command = kept_in_view(place(143), EAST, HORIZON)
    assert np.hypot(*command.field) == pytest.approx(5e-3)
    assert command.field[0] == pytest.approx(2.5e-3)
    assert 'about to leave the view' in command.progress.message


@pytest.mark.parametrize('x_um', [144.0, 145.0, 500.0])
def test_who_is_outside_comes_back(x_um):
    most = 0 if x_um == 144 else -2.5e-3 + 1e-12
    assert kept_in_view(place(x_um), EAST, HORIZON).field[0] <= most + 1e-9


def test_what_is_not_known_not_meant_or_not_driven_is_left_alone():
    unknown = place(143, phi_std=np.array([np.inf]))
    assert kept_in_view(unknown, EAST, HORIZON) is EAST
    others = FieldCommand(EAST.field, particles=np.array([7]))
    assert kept_in_view(place(143), others, HORIZON) is others
    off = FieldCommand(np.zeros(2))
    assert kept_in_view(place(143), off, HORIZON) is off
    rolling = Model(5e-3, 'rolling')
    assert kept_in_view(place(143, model=rolling), EAST, HORIZON) is EAST
    rolls = FieldCommand(EAST.field, 1.0)
    assert kept_in_view(place(143, model=rolling), rolls, HORIZON).field[0] < 4e-3


def test_it_is_the_field_at_the_particle_that_is_turned():
    model = Model(5e-3, effects=(BackgroundField(bx=0.0, by=1e-3),))
    command = kept_in_view(place(144, model=model), EAST, HORIZON)
    assert model.field(command.field)[0] == pytest.approx(0, abs=1e-6)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 5), st.floats(-np.pi, np.pi))
def test_no_direction_keeps_more_and_none_that_keeps_as_many_is_nearer(seed, count, angle):
    """Against all directions, half a degree apart."""
    rng = np.random.default_rng(seed)
    at = VIEW.high * np.sign(rng.normal(size=(count, 2))) + rng.normal(0, 1.5e-6, (count, 2))
    shown = controller_input(count, seed=seed, position=at, expected=at)
    u = np.exp(1j * angle)
    command = kept_in_view(shown, FieldCommand(5e-3 * np.array([u.real, u.imag])), HORIZON)
    found = complex(*command.field) / 5e-3
    ways = np.append(np.exp(1j * np.arange(0, 2 * np.pi, np.pi / 360)), [found, u])
    velocity = shown.speed * np.exp(1j * shown.phi) * ways[:, None]
    lost = np.zeros(len(ways), int)
    for out, room in ((velocity.real, VIEW.high[0] - at[:, 0]),
                      (-velocity.real, at[:, 0] - VIEW.low[0]),
                      (velocity.imag, VIEW.high[1] - at[:, 1]),
                      (-velocity.imag, at[:, 1] - VIEW.low[1])):
        lost += (out > np.maximum(room / HORIZON, -0.5 * shown.speed) + 1e-12).sum(1)
    assert lost[-2] == lost.min()
    as_good = np.abs(ways - u)[lost == lost.min()]
    assert abs(found - u) <= as_good.min() + 1e-9


@pytest.mark.parametrize(('controller', 'parameters'), [
    (OpenLoop, OpenLoopParameters(directions_deg=[20.0], durations_s=[60.0])),
    (Teleop, TeleopParameters())])
def test_whichever_drives_a_particle_stays_and_goes_along_the_border(controller, parameters):
    it = controller()
    it.configure(parameters)
    manager = ControllerManager({'it': it}, 'it', deadline=5.0)
    at, dt = np.array([[130e-6, 0.0]]), 0.05
    for k in range(400):
        shown = controller_input(1, t=k * dt, dt=dt, age=0.0, delay=0.0, position=at,
                          speed=np.array([4e-6]), phi=np.zeros(1),
                          joystick=np.array([0.94, 0.34]))
        outcome = manager.tick(shown)
        assert outcome.result is Result.OK
        field = outcome.command.field
        at = at + 4e-6 * dt * field / max(np.hypot(*field), 1e-12)
        assert VIEW.holds(at).all()
    assert at[0, 1] > 50e-6


def test_it_can_be_left_out():
    it = OpenLoop()
    it.configure(OpenLoopParameters(directions_deg=[0.0], durations_s=[60.0]))
    manager = ControllerManager({'it': it}, 'it', deadline=5.0, border=0.0)
    outcomes = [manager.tick(place(150, t=0.1 * k, dt=0.1)) for k in range(3)]
    assert outcomes[-1].command.field == pytest.approx([5e-3, 0])
