"""Controllers of one particle or of the field alone: waypoint, roller, teleop, open_loop, hold."""

import cmath
import dataclasses

import numpy as np
import pytest

from microbot_ros.common.errors import InputError
from microbot_ros.control.contract import (
    Goals,
    Limits,
    ModelError,
    NoSolutionError,
    NotLearnedError,
    ParticleLostError,
    Result,
)
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.open_loop import OpenLoop, OpenLoopParameters
from microbot_ros.control.plugins.roller import Roller, RollerParameters
from microbot_ros.control.plugins.teleop import Teleop, TeleopParameters
from microbot_ros.control.plugins.waypoint import Waypoint, WaypointParameters
from microbot_ros.control.testkit import controller_input
from microbot_ros.model.model import Model

DT = 1 / 60
SQUARE = np.array([[20e-6, 20e-6], [-20e-6, 20e-6], [-20e-6, -20e-6]])


def drive(controller, goals, seconds, *, answer, rolling=False, learned_after=0.0, drift=0j):
    """A particle that obeys the first-order model two ticks late; places and outcomes."""
    delay = 2
    manager = ControllerManager({'it': controller}, 'it', deadline=5.0)
    rng, place, queue = np.random.default_rng(1), 0j, [(0j, 0.0)] * delay
    places, outcomes = [], []
    for k in range(round(seconds / DT)):
        t = k * DT
        seen = np.array([[place.real, place.imag]]) + rng.normal(0, 5e-8, (1, 2))
        known = t >= learned_after
        outcome = manager.tick(controller_input(
            1, t=t, dt=DT, age=0.0, delay=delay * DT, position=seen, goals=Goals(goals),
            speed=np.array([abs(answer) if known else np.nan]),
            phi=np.array([cmath.phase(answer) if known else np.nan]),
            phi_std=np.array([0.05 if known else np.inf]),
            model=Model(5e-3, 'rolling' if rolling else 'catalytic')))
        queue.append((complex(*outcome.command.field), outcome.command.frequency))
        field, frequency = queue.pop(0)
        pace = frequency if rolling else 1.0
        place += ((answer * pace * field / abs(field) if field else 0) + drift) * DT
        places.append(place)
        outcomes.append(outcome)
    return np.array(places), outcomes


def test_waypoint_visits_all_and_circles_the_last():
    places, outcomes = drive(Waypoint(), SQUARE, 40, answer=cmath.rect(4e-6, 2.5))
    for x, y in SQUARE:
        assert np.abs(places - complex(x, y)).min() <= 2.1e-6
    last = np.abs(places[-600:] - complex(*SQUARE[-1]))
    assert last.mean() == pytest.approx(1e-6, abs=0.2e-6)
    assert last.max() < 1.6e-6
    assert outcomes[-1].command.progress.done
    straight = abs(complex(*SQUARE[0])) + 40e-6 + 40e-6
    arrival = np.argmax(np.abs(places - complex(*SQUARE[-1])) < 2e-6) * DT
    assert arrival <= 1.05 * straight / 4e-6


def test_waypoint_learns_by_itself_then_goes():
    places, outcomes = drive(
        Waypoint(), SQUARE[:1], 15, answer=cmath.rect(4e-6, -2), learned_after=np.inf)
    assert 'learns' in outcomes[50].message
    assert outcomes[-1].command.progress.done
    last = np.abs(places[-300:] - complex(*SQUARE[0]))
    assert last.mean() == pytest.approx(1e-6, abs=0.3e-6)


@pytest.mark.parametrize('drift', [0.8e-6, -0.8e-6j])
def test_waypoint_goes_straight_and_circles_evenly_in_a_drift(drift):
    goal = SQUARE[:1]
    places, _ = drive(Waypoint(), goal, 25, answer=cmath.rect(4e-6, 2.5), drift=drift)
    to_goal = complex(*goal[0])
    on_the_way = places[180:np.argmax(np.abs(places - to_goal) < 3e-6)]
    off = (on_the_way - on_the_way[0]) * np.conj(to_goal - on_the_way[0])
    assert np.abs(off.imag / abs(to_goal)).max() < 1.2e-6
    last = np.abs(places[-480:] - to_goal)
    assert last.max() < 1.7e-6


def test_roller_holds_still_against_a_drift():
    places, _ = drive(Roller(), SQUARE[:1], 25, answer=cmath.rect(2e-6, 0.7), rolling=True,
                      drift=0.7e-6)
    assert np.abs(places[-600:] - complex(*SQUARE[0])).max() < 0.8e-6


def test_waypoint_cancels_and_reports_what_is_wrong():
    manager = ControllerManager({'it': Waypoint()}, 'it', deadline=5.0)
    assert not np.any(manager.tick(controller_input()).command.field)
    outside = Goals(np.array([[1.0, 0.0]]))
    assert manager.tick(controller_input(goals=outside)).result is Result.BAD_GOAL
    gone = Goals(SQUARE, np.array([9, 9, 9]))
    assert manager.tick(controller_input(goals=gone)).result is Result.PARTICLE_LOST
    assert manager.tick(controller_input(0, goals=Goals(SQUARE))).result is Result.PARTICLE_LOST
    assert manager.tick(controller_input(goals=Goals(SQUARE))).result is Result.OK
    assert 'waits' in manager.tick(controller_input(goals=Goals())).message


def test_a_named_particle_must_be_there_to_take_over():
    waypoint = Waypoint()
    waypoint.configure(WaypointParameters(particle=8))
    with pytest.raises(ParticleLostError, match='particle 8'):
        waypoint.activate(controller_input())


def test_roller_goes_and_stops():
    places, outcomes = drive(
        Roller(), SQUARE[:1], 12, answer=cmath.rect(2e-6, 0.7), rolling=True)
    assert abs(places[-1] - complex(*SQUARE[0])) < 0.6e-6
    assert np.abs(np.diff(places[-120:])).max() < 1e-7
    assert outcomes[-1].command.progress.done
    frequencies = [outcome.command.frequency for outcome in outcomes]
    assert max(frequencies) == pytest.approx(5.0)
    assert min(f for f in frequencies if f > 0) >= 0.5


def test_roller_refuses_the_wrong_model_and_parameters():
    for model in (None, Model(5e-3)):
        with pytest.raises(ModelError, match='propulsion: rolling'):
            Roller().activate(controller_input(model=model))
    with pytest.raises(ValueError, match='slowest_hz'):
        Roller().configure(RollerParameters(slowest_hz=6.0))


@pytest.mark.parametrize('stick', [(0, 0), (0.1, 0.1), (np.nan, 0), (0, np.nan)])
def test_stick_at_rest_is_no_field(stick):
    command = Teleop().compute(controller_input(joystick=np.array(stick)))
    assert not np.any(command.field)


def test_stick_steers_the_field_or_a_particle():
    teleop = Teleop()
    shown = controller_input(2, joystick=np.array([0.0, 2.0]), phi=np.array([0.5, np.nan]))
    assert teleop.compute(shown).field == pytest.approx([0, 5e-3])
    teleop.configure(TeleopParameters(particle=0, frequency_hz=10.0))
    command = teleop.compute(shown)
    assert np.arctan2(*command.field[::-1]) == pytest.approx(np.pi / 2 - 0.5)
    assert command.frequency == pytest.approx(10.0)
    teleop.configure(TeleopParameters(particle=1))
    with pytest.raises(NotLearnedError):
        teleop.compute(shown)
    teleop.configure(TeleopParameters(particle=5))
    with pytest.raises(ParticleLostError):
        teleop.activate(shown)


def play(controller, times, **changes):
    controller.activate(controller_input(t=100.0))
    return [controller.compute(controller_input(t=100.0 + t, **changes)) for t in times]


def test_open_loop_plays_each_row_until_the_next():
    loop = OpenLoop()
    loop.configure(OpenLoopParameters(
        directions_deg=[0.0, 90.0], durations_s=[1.0, 2.0], field_mT=2.0, frequency_hz=3.0))
    commands = play(loop, [0, 0.999, 1.0, 2.999, 3.0, 99.0])
    fields = np.array([command.field for command in commands])
    assert fields == pytest.approx(np.array(
        [[2, 0], [2, 0], [0, 2], [0, 2], [0, 0], [0, 0]]) * 1e-3, abs=1e-15)
    assert [command.frequency for command in commands] == [3, 3, 3, 3, 0, 0]
    assert [command.progress.done for command in commands] == [False] * 4 + [True] * 2


def test_open_loop_ends_where_the_clock_is_set_back():
    loop = OpenLoop()
    loop.configure(OpenLoopParameters(directions_deg=[0.0], durations_s=[2.0]))
    before, *after = play(loop, [1.0, -3600.0, 1.0])
    assert before.field.any()
    assert not any(command.field.any() for command in after)


def test_open_loop_repeats():
    loop = OpenLoop()
    loop.configure(OpenLoopParameters(
        directions_deg=[0.0, 90.0], durations_s=[1.0, 2.0], repeat=True))
    first, again = play(loop, [0.5, 3.5])
    assert np.array_equal(first.field, again.field)


@pytest.mark.parametrize(('header', 'rows', 'expected'), [
    ('t_s,bx_mT,by_mT', ['10,1,0', '10.5,0,-2'], [[1e-3, 0], [0, -2e-3], [0, 0]]),
    ('t_s,direction_rad,frequency_hz', ['0,0,4', '0.5,1.5707963267948966,2'],
     [[5e-3, 0], [0, 5e-3], [0, 0]])])
def test_open_loop_plays_a_file(tmp_path, header, rows, expected):
    file = tmp_path / 'commands.csv'
    file.write_text('\n'.join([header, *rows, '']))
    loop = OpenLoop()
    loop.configure(OpenLoopParameters(file=str(file)))
    fields = np.array([command.field for command in play(loop, [0.1, 0.6, 1.1])])
    assert fields == pytest.approx(np.array(expected), abs=1e-15)


@pytest.mark.parametrize('content', [
    None, '', 't_s,bx_mT,by_mT\n', 't_s,bx_mT,by_mT\n0,nan,0\n', 't_s,bx_mT,by_mT\n1,0,0\n1,1,0\n',
    't_s,angle\n0,1\n'])
def test_a_file_that_is_wrong_is_refused_by_name(tmp_path, content):
    file = tmp_path / 'commands.csv'
    if content is not None:
        file.write_text(content)
    loop = OpenLoop()
    before = dataclasses.replace(loop.parameters)
    with pytest.raises(InputError, match=r'commands\.csv'):
        loop.configure(OpenLoopParameters(file=str(file)))
    assert loop.parameters == before


def test_a_list_beyond_the_limits_does_not_take_over():
    loop = OpenLoop()
    with pytest.raises(NoSolutionError, match='limit is 1 mT'):
        loop.activate(controller_input(limits=Limits(field=1e-3)))
    loop.configure(OpenLoopParameters(frequency_hz=50.0))
    with pytest.raises(NoSolutionError, match='Hz'):
        loop.activate(controller_input(limits=Limits(frequency=10.0)))
    with pytest.raises(ValueError, match='one duration per direction'):
        loop.configure(OpenLoopParameters(directions_deg=[1.0]))
