"""The route's geometry, the filter behind the integral action, and both in a loop."""

import cmath

import numpy as np
import pytest

from microbot_ros.control.contract import GoalError
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.planning.route import Route
from microbot_ros.control.plugins.path_following import PathFollowing, PathFollowingParameters
from microbot_ros.control.steering.drift_observer import DriftObserver
from microbot_ros.control.testkit import controller_input

ANGLE = np.linspace(0, 2 * np.pi, 361)
CIRCLE = 20e-6 * np.column_stack((np.cos(ANGLE), np.sin(ANGLE)))
CIRCLE[-1] = CIRCLE[0]


def test_circle_has_its_length_tangent_and_nearest_point():
    route = Route(CIRCLE)
    assert route.closed
    assert route.length == pytest.approx(2 * np.pi * 20e-6, rel=1e-4)
    for angle in (0.3, 2.0, 6.1):
        along = route.nearest(19e-6 * cmath.exp(1j * angle), None, 0)
        point, way = route.at(along)
        assert point == pytest.approx(20e-6 * cmath.exp(1j * angle), rel=1e-3)
        assert way == pytest.approx(1j * cmath.exp(1j * angle), abs=1e-3)
    assert route.at(route.length + 3e-6)[0] == pytest.approx(route.at(3e-6)[0])


def test_where_a_route_crosses_itself_the_branch_is_kept():
    route = Route(np.array([[-10, 0], [10, 0], [10, 10], [0, 10], [0, -10]]) * 1e-6)
    assert route.nearest(0.1e-6j, 9e-6, 4e-6) == pytest.approx(10e-6)
    assert route.nearest(0.1e-6j, 49e-6, 4e-6) == pytest.approx(49.9e-6)


def test_open_route_ends():
    route = Route(np.array([[0, 0], [0, 0], [3, 4]]) * 1e-6)
    assert not route.closed
    assert route.length == pytest.approx(5e-6)
    assert route.end == pytest.approx(3e-6 + 4e-6j)
    assert route.at(1.0)[0] == pytest.approx(route.end)


@pytest.mark.parametrize('points', [
    np.empty((0, 2)), np.zeros((1, 2)), np.zeros((5, 2)), np.array([[0, 0], [np.nan, 1]]),
    np.array([[0, 0], [np.inf, 1]])])
def test_what_is_no_route(points):
    with pytest.raises(ValueError, match='path must'):
        Route(points)


def test_observer_learns_answer_and_drift_within_its_own_error_bars():
    rng = np.random.default_rng(2)
    answer, drift, sigma, dt = cmath.rect(4e-6, 2.2), 0.4e-6 - 0.3e-6j, 5e-8, 1 / 60
    z = 0j
    observer = DriftObserver(z, 0j, 10e-6, 1e-6)
    for k in range(1200):
        shared = dt * cmath.exp(1j * 2 * np.pi * k / 400)
        z += answer * shared + drift * dt
        seen = z + complex(*rng.normal(0, sigma, 2))
        observer.update(shared, dt, seen, sigma)
    assert abs(observer.answer - answer) < 4 * observer.answer_std
    assert observer.answer_std < 0.3e-6
    assert abs(observer.drift - drift) < 0.2e-6
    assert abs(observer.ahead(0.1, 0.1) - (z + 0.1 * (answer + drift))) < 0.15e-6


def follow(path, seconds, start=0j, drift=0.5e-6j, **parameters):
    """A particle that obeys dp/dt = c u + w exactly; offsets after each tick."""
    rng, answer, dt = np.random.default_rng(0), cmath.rect(4e-6, -1.1), 1 / 60
    controller = PathFollowing()
    controller.configure(PathFollowingParameters(**parameters))
    manager = ControllerManager({'it': controller}, 'it', deadline=5.0)
    place, places, outcome = start, [], None
    unknown = {name: np.full(1, np.nan) for name in ('speed', 'phi')}
    unknown |= {name: np.full(1, np.inf) for name in ('speed_std', 'phi_std')}
    for k in range(round(seconds / dt)):
        seen = np.array([[place.real, place.imag]]) + rng.normal(0, 3e-8, (1, 2))
        outcome = manager.tick(controller_input(
            1, t=k * dt, dt=dt, age=0.0, delay=0.0, position=seen, path=path, **unknown))
        field = complex(*outcome.command.field)
        place += (answer * field / abs(field) if field else 0) * dt + drift * dt
        places.append(place)
    return np.array(places), outcome


def test_follows_a_circle_against_drift_from_knowing_nothing():
    places, _ = follow(CIRCLE, 45, start=22e-6 + 0j)
    off = np.abs(places[900:]) - 20e-6
    assert np.sqrt(np.mean(off**2)) < 0.1e-6
    turns = np.unwrap(np.angle(places))
    assert turns[-1] - turns[0] > 2 * np.pi


def test_stays_at_the_end_of_an_open_path():
    line = np.array([[0, 0], [30e-6, 0]])
    places, outcome = follow(line, 25, hold_radius_um=1.0)
    assert outcome.command.progress.done
    assert np.abs(places[-300:] - 30e-6).max() < 2e-6


@pytest.mark.parametrize('path', [
    np.array([[0, 0], [200e-6, 0]]), np.array([[np.nan, 0], [0, 0]]), np.zeros((3, 2)),
    np.array([[1e-6, 1e-6]])])
def test_paths_that_can_not_be_followed(path):
    with pytest.raises(GoalError, match='path'):
        PathFollowing().compute(controller_input(path=path))


def test_empty_path_lets_go_and_another_starts_anew():
    controller = PathFollowing()
    command = controller.compute(controller_input())
    assert not np.any(command.field)
    assert 'waiting' in command.progress.message
    controller.compute(controller_input(t=0.1, path=CIRCLE))
    assert not np.any(controller.compute(controller_input(t=0.2)).field)


@pytest.mark.parametrize('place', [70e-6 + 40e-6j, 20e-6 + 30e-6j])
def test_beside_the_end_of_a_path_is_not_at_its_end(place):
    """The end is the nearest point, and nothing is left of the path from there."""
    controller = PathFollowing()
    controller.configure(PathFollowingParameters())
    path = np.column_stack((np.linspace(0, 20e-6, 21), np.zeros(21)))
    position = np.array([[place.real, place.imag]])
    outcome = controller.compute(controller_input(1, position=position, path=path))
    assert outcome.field.any()
    assert not outcome.progress.done
    assert outcome.progress.distance == pytest.approx(abs(place - 20e-6), rel=0.02)
