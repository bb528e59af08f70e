"""Plans against the model's own integrator, obstacles and views kept, goals beyond the floor."""

import itertools

import numpy as np
import pytest

from microbot_ros.common.records import Commands
from microbot_ros.control.contract import Goals, ModelError, Workspace
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.planning.manoeuvre import Task, search
from microbot_ros.control.planning.plan import Plan, Swarm, roll_out, with_lags
from microbot_ros.control.planning.refine import cost, improve
from microbot_ros.control.planning.shared import as_complex, floor
from microbot_ros.control.plugins.predictive import Predictive, PredictiveParameters
from microbot_ros.control.reach import opened, planned_floor, reach
from microbot_ros.control.testkit import VIEW, controller_input
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.effects.velocity.linear_flow import LinearFlow
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters

LIMIT = 5e-3
EVERYWHERE = Workspace(np.full(2, -1.0), np.full(2, 1.0))
ANSWER = 4e-6 * np.exp(1j * np.array([0.3, 2.1]))


def make(model=None, lags=(0.1, 0.3), start=(0j, 30e-6 + 0j)):
    model = Model(LIMIT) if model is None else model
    return Swarm(np.arange(2), np.array(start), ANSWER, np.ones(2, complex),
                 with_lags(model, list(lags)), 0.0)


def task(goal, view=EVERYWHERE, obstacles=(), clearance=()):
    return Task(np.array(goal), LIMIT, view, np.array(obstacles, complex), np.array(clearance),
                1e-8, 0.0)


def some_plan(seed, count=12):
    rng = np.random.default_rng(seed)
    field = rng.normal(0, 0.4 * LIMIT, (count, 2)) * (rng.uniform(size=(count, 1)) > 0.2)
    return Plan(rng.uniform(0.02, 1.0, count), field)


@pytest.mark.parametrize('effects', [
    (), (UniformDrift(wx=0.5e-6, wy=-0.2e-6),)])
def test_a_plan_comes_to_what_the_models_integrator_says(effects):
    model = Model(LIMIT, effects=(*effects, AlignmentLag(0.2)))
    swarm, plan = make(model, lags=(None, None)), some_plan(1)
    edges = np.concatenate([[0.0], np.cumsum(plan.duration)])
    particles = ParticleParameters.from_velocity_phasor(np.arange(2), ANSWER)
    start = np.stack([swarm.position.real, swarm.position.imag], -1)
    expected = simulate(model, particles, Commands(edges[:-1], plan.field), edges, start,
                        heading=particles.phi)
    found = roll_out(swarm, plan, LIMIT).position
    assert np.abs(found - as_complex(expected[1:])).max() < 1e-11


def test_response_is_the_derivative():
    swarm, plan = make(), some_plan(2)
    rollout = roll_out(swarm, plan, LIMIT)
    rng = np.random.default_rng(0)
    step = rng.normal(0, 1e-4, plan.field.shape)
    moved = roll_out(swarm, Plan(plan.duration, plan.field + LIMIT * step), LIMIT).position
    assert np.abs(rollout.position + rollout.response @ step.ravel() - moved).max() < 2e-10
    assert np.abs(moved - rollout.position).max() > 1e-9


def test_what_is_left_of_a_plan():
    plan = Plan(np.array([1.0, 2.0, 3.0]), np.arange(6.0).reshape(3, 2))
    left = plan.after(1.5)
    assert left.duration.tolist() == [1.5, 3.0]
    assert left.field.tolist() == [[2, 3], [4, 5]]
    assert plan.after(0.4).length == pytest.approx(5.6)
    assert len(plan.after(6.0).duration) == 0


def refined(swarm, asked):
    plan = search(swarm, asked)
    rollout = roll_out(swarm, plan, LIMIT)
    before = cost(swarm, plan, asked, rollout)
    for _ in range(40):
        plan, rollout = improve(swarm, plan, asked, rollout, 1.0)
    assert cost(swarm, plan, asked, rollout) <= before
    assert np.hypot(*plan.field.T).max() <= LIMIT * (1 + 1e-9)
    return plan, rollout


@pytest.mark.parametrize('goal', [(20e-6, 30e-6 - 15e-6j), (-10e-6j, 10e-6 + 10e-6j)])
def test_different_lags_open_goals_that_one_field_can_not_serve(goal):
    swarm, asked = make(), task(goal)
    assert floor(ANSWER, asked.goal - swarm.position) > 10e-6
    _, rollout = refined(swarm, asked)
    assert np.abs(rollout.position[-1] - asked.goal).max() < 0.2e-6


def test_a_search_counts_on_the_drift():
    """Before any refinement: a plan that did not would end 5 µm off."""
    drift = UniformDrift(wx=1.0e-6, wy=0.5e-6)
    swarm = Swarm(np.arange(1), np.array([0j]), np.array([4e-6 + 0j]), np.ones(1, complex),
                  with_lags(Model(LIMIT, effects=(drift,)), [None]), 0.0)
    asked = task([-20e-6 + 0j])
    end = roll_out(swarm, search(swarm, asked), LIMIT).position[-1]
    assert np.abs(end - asked.goal)[0] < 2e-6


def test_equal_lags_open_nothing():
    swarm, asked = make(lags=(0.2, 0.2)), task((20e-6, 30e-6 - 15e-6j))
    lowest = floor(ANSWER, asked.goal - swarm.position)
    _, rollout = refined(swarm, asked)
    left = np.sqrt(np.mean(np.abs(rollout.position[-1] - asked.goal) ** 2))
    assert left >= lowest * (1 - 1e-9)


def test_plans_go_round_obstacles_and_stay_in_view():
    swarm = Swarm(np.arange(1), np.array([-25e-6 + 0j]), np.array([4e-6 + 0j]),
                  np.ones(1, complex), with_lags(Model(LIMIT), [0.05]), 0.0)
    view = Workspace(np.array([-30e-6, -8e-6]), np.array([30e-6, 30e-6]))
    asked = task([25e-6 + 0j], view, [-1e-6j], [8e-6])
    _, rollout = refined(swarm, asked)
    assert np.abs(rollout.position[-1] - asked.goal)[0] < 1e-6
    assert np.abs(rollout.position + 1e-6j).min() > 7.5e-6
    assert rollout.position.imag.min() > -8.3e-6


def lag_loop(theta_seen, seconds=20.0, **parameters):
    """Two particles with lags 0.1 and 0.3 s, integrated by Euler's method at 1 ms.

    The budget is counted in looks at the clock, so a busy machine plans no worse.
    """
    looks = itertools.count(0, 0.016)
    controller = Predictive(clock=lambda: next(looks))
    controller.configure(PredictiveParameters(
        alignment_times_s=[0.1, 0.3], budget_ms=100.0, **parameters))
    manager = ControllerManager({'it': controller}, 'it', deadline=10.0)
    place, theta, dt = np.array([-20e-6 + 0j, 20e-6 + 0j]), np.array([0.3, 2.1]), 0.05
    goal = np.array([[-20e-6, 18e-6], [20e-6, 18e-6]])
    turned = np.angle(ANSWER)
    rate, errors = 1 / np.array([0.1, 0.3]), []
    for k in range(round(seconds / dt)):
        seen = np.stack([place.real, place.imag], -1)
        outcome = manager.tick(controller_input(
            2, t=k * dt, dt=dt, age=0.0, delay=0.0, position=seen,
            theta=theta if theta_seen else np.full(2, np.nan), speed=np.abs(ANSWER), phi=turned,
            goals=Goals(goal), model=Model(LIMIT)))
        field = complex(*outcome.command.field) / LIMIT
        for _ in range(50):
            theta = theta + 1e-3 * rate * (field * np.exp(1j * (turned - theta))).imag
            place = place + 1e-3 * np.abs(ANSWER) * np.exp(1j * theta)
        errors.append(np.sqrt(np.mean(np.abs(place - as_complex(goal)) ** 2)))
    return np.array(errors), floor(ANSWER, as_complex(goal) - np.array([-20e-6, 20e-6]))


@pytest.mark.parametrize('theta_seen', [True, False])
def test_two_particles_end_far_below_the_first_order_floor(theta_seen):
    errors, lowest = lag_loop(theta_seen)
    assert lowest > 10e-6
    assert errors[-60:].mean() < 0.35 * lowest


def test_what_predictive_needs_and_refuses():
    controller = Predictive()
    with pytest.raises(ModelError, match='needs a model'):
        controller.activate(controller_input())
    with pytest.raises(ModelError, match='rollers'):
        controller.activate(controller_input(model=Model(LIMIT, 'rolling')))
    with pytest.raises(ValueError, match='received 4 numbers'):
        controller.configure(PredictiveParameters(obstacles_um=[0.0, 1.0, 2.0, 3.0]))


def test_without_lag_it_does_as_well_as_the_ensemble():
    controller = Predictive()
    controller.configure(PredictiveParameters())
    goals = Goals(np.array([[10e-6, 0], [0, 10e-6], [5e-6, 5e-6]]))
    shown = controller_input(goals=goals, model=Model(LIMIT))
    command = controller.compute(shown)
    assert np.hypot(*command.field) == pytest.approx(LIMIT, rel=0.05)


def test_reach_names_the_two_dimensions_and_what_is_left():
    position, goal = np.array([0j, 30e-6 + 0j]), np.array([20e-6 + 0j, 30e-6 - 15e-6j])
    found = reach(ANSWER, position, goal)
    assert found.subspace.T @ found.subspace == pytest.approx(np.eye(2))
    moved = np.stack([(ANSWER * 2j).real, (ANSWER * 2j).imag], -1).ravel()
    assert found.subspace @ (found.subspace.T @ moved) == pytest.approx(moved)
    left = np.stack([found.left.real, found.left.imag], -1).ravel()
    assert found.subspace.T @ left == pytest.approx(0, abs=1e-18)
    assert found.floor == pytest.approx(floor(ANSWER, goal - position))


def test_what_is_opened_is_nothing_without_and_something_with_a_difference():
    rng = np.random.default_rng(0)
    equal = opened(make(lags=(0.2, 0.2)), LIMIT, 5.0, rng, 50)
    different = opened(make(lags=(0.1, 0.3)), LIMIT, 5.0, rng, 50)
    drifting = make(Model(LIMIT, effects=(UniformDrift(1e-6, 0.0),)), lags=(0.2, 0.2))
    for handle, values in different.items():
        assert values.shape == (2,)
        assert values.min() > 1e-6
        assert equal[handle].max() < 1e-12
        assert opened(drifting, LIMIT, 5.0, rng, 50)[handle].max() < 1e-12
    flow = make(Model(LIMIT, effects=(LinearFlow(0.05, 0.0, 0.0, -0.05),)), lags=(0.2, 0.2))
    assert opened(flow, LIMIT, 5.0, rng, 50)['direction'].max() > 1e-8
    assert planned_floor(make(), np.array([20e-6 + 0j, 30e-6 - 15e-6j]), LIMIT, VIEW) < 0.2e-6
