"""Rollers to goals of their own: the ways, and the whole of it in physics that knows more."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench._rolling_loop import Rollers, RollingLoop
from microbot_ros.control.contract import (
    Goals,
    ModelError,
    NoSolutionError,
    ParticleLostError,
    Workspace,
)
from microbot_ros.control.planning.swarm_paths import Room, between, find_ways
from microbot_ros.control.plugins.swarm import Swarm, SwarmParameters
from microbot_ros.control.testkit import VIEW, controller_input
from microbot_ros.model.model import Model

WALLS_UM = [0.0, -104.0, 0.0, -15.0, 0.0, 15.0, 0.0, 104.0]
NO_WALLS = np.empty((0, 2), complex)


def ways(start, goal, room):
    search = find_ways(np.array(start), np.array(goal), room)
    while True:
        try:
            next(search)
        except StopIteration as found:
            return found.value


def swarm(**parameters):
    controller = Swarm()
    controller.configure(SwarmParameters(**parameters))
    return controller


def test_ways_pass_a_slit_one_after_the_other():
    walls = np.array([[-104e-6j, -15e-6j], [15e-6j, 104e-6j]])
    room = Room(VIEW, walls, 15e-6, 8e-6)
    start = [-40e-6, -40e-6 + 20e-6j, -40e-6 - 20e-6j]
    found = ways(start, [40e-6 - 20e-6j, 40e-6, 40e-6 + 20e-6j], room)
    assert found[0] == pytest.approx(np.array(start))
    assert between(found).min() >= room.apart - 1e-9
    assert room.to_walls(found).min() >= room.off_walls - 1e-9
    assert (np.abs(np.diff(found, axis=0)) < 6e-6).all()
    for k in range(3):  # through the slit, not through the wall
        way = found[:, k]
        last = np.flatnonzero(way.real < 0)[-1]
        assert abs(way[last].imag) < 15e-6


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_ways_keep_apart_and_end_at_the_goals(seed):
    rng = np.random.default_rng(seed)
    places = (np.arange(6) % 3 + 1j * (np.arange(6) // 3)) * 40e-6 - 60e-6
    room = Room(VIEW, NO_WALLS, 14e-6, 5e-6)
    start, goal = rng.permutation(places), rng.permutation(places)
    found = ways(start, goal, room)
    assert found[-1] == pytest.approx(goal)
    assert between(found).min() >= room.apart - 1e-9


def test_where_there_is_no_way_it_says_so():
    wall = np.array([[-104e-6j, 104e-6j]])
    room = Room(VIEW, wall, 14e-6, 5e-6)
    with pytest.raises(NoSolutionError):
        ways([-40e-6 + 0j], [40e-6 + 0j], room)


def test_alone_there_is_no_neighbour():
    assert np.isinf(between(np.array([[1e-6 + 0j]]))).all()


def test_a_border_is_a_wall():
    room = Room(Workspace(np.array([0.0, 0.0]), np.array([1.0, 1.0])), NO_WALLS, 0, 0)
    assert room.to_walls(np.array([0.3 + 0.5j, 0.9 + 0.5j, -0.1 + 0.5j])) == pytest.approx(
        [0.3, 0.1, -0.1])


def test_two_rollers_pass_a_slit_to_goals_crosswise_and_touch_nothing():
    """Against moments that slip, Brownian motion and stirred water, of which it knows nothing."""
    start = 1e-6 * np.array([[-20.0, 10.0], [-20.0, -15.0]])
    goal = 1e-6 * np.array([[20.0, -15.0], [20.0, 12.0]])
    rollers = Rollers(1e-6 * np.array([3.0, 3.4]), np.array([0.3, -0.4]),
                      np.array([6.0, 14.0]), np.full(2, 2.3e-6))
    loop = RollingLoop(rollers, start, 1, walls=1e-6 * np.array(WALLS_UM))
    done = []

    def note(t, outcome):
        if outcome.command.progress.done:
            done.append(t)
        return bool(done)

    controller = swarm(walls_um=WALLS_UM, slowest_hz=5.0, fastest_hz=20.0)
    loop.run(controller, 60.0, note, goals=Goals(goal))
    assert done
    assert np.hypot(*(loop.world.position - goal).T).max() < 3.1e-6
    assert not loop.world.touched.any()


def rolling(**changes):
    return controller_input(model=Model(5e-3, 'rolling'), **changes)


def test_it_asks_for_rollers_and_for_all_of_them():
    for model in (None, Model(5e-3, 'catalytic')):
        with pytest.raises(ModelError, match='propulsion: rolling'):
            swarm().activate(controller_input(model=model))
    controller, goals = swarm(), Goals(np.array([[2e-5, 0.0]]))
    controller.activate(rolling())
    for k in range(10):
        controller.compute(rolling(t=k / 60, goals=goals))
    whole = rolling(goals=goals)
    rows = {name: getattr(whole, name)[:2] for name in (
        'ids', 'position', 'sigma', 'theta', 'speed', 'phi', 'speed_std', 'phi_std')}
    with pytest.raises(ParticleLostError, match='particle 2 is not tracked'):
        controller.compute(dataclasses.replace(whole, **rows))


def test_walls_are_four_numbers_each():
    with pytest.raises(ValueError, match='received 3'):
        swarm(walls_um=[0.0, 1.0, 2.0])


def test_whom_it_can_tell_nothing_of_it_refuses_and_stands_still():
    """All three are displaced by the same, whatever the field: they can't be told apart."""
    controller, goals = swarm(slowest_hz=20.0, fastest_hz=30.0), Goals(np.array([[2e-5, 0.0]]))
    controller.activate(rolling())
    seen, messages = rolling(), set()
    for k in range(600):
        shown = dataclasses.replace(seen, t=k / 60, goals=goals)
        try:
            command = controller.compute(shown)
        except NoSolutionError as error:
            messages.add(str(error))
            continue
        assert not messages
        way = command.field / 5e-3 * (command.frequency > 1) * 3e-6 * command.frequency / 60
        seen = dataclasses.replace(seen, position=seen.position + way)
    assert [message.split(' ')[1:5] for message in messages] == [['number', '0', 'and', '1']]


def test_a_particle_that_was_lost_in_the_survey_is_surveyed_again():
    controller, goals = swarm(slowest_hz=20.0, fastest_hz=30.0), Goals(np.array([[2e-5, 0.0]]))
    controller.activate(rolling())
    for k in range(40):
        controller.compute(rolling(t=k / 60, goals=goals))
    with pytest.raises(ParticleLostError):
        controller.compute(rolling(count=2, t=1.0, goals=goals))
    command = controller.compute(rolling(t=1.1, goals=goals))
    assert command.progress.message == 'measuring the frame rate'
