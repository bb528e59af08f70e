"""Every controller under every effect that discovery may have found, and plans in true physics."""

import dataclasses
import itertools

import numpy as np
import pytest

from microbot_ros.control.contract import ControllerError, Goals, Result
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.predictive import Predictive, PredictiveParameters
from microbot_ros.control.registry import controller_classes
from microbot_ros.control.testkit import VIEW, controller_input
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model
from microbot_ros.model.physics.particle import Fluid, rotational_drag
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.world import FieldHistory, World

LIMIT = 5e-3
CLASSES = controller_classes()
SINCE_1970 = 1.8e9
"""The clock of a rig: an effect that counts its time from there would be out of all bounds."""


def some(effect):
    """The effect, half its typical size."""
    return effect(**{p.field: p.from_fit(0.5) for p in effect.parameters()})


@pytest.mark.parametrize('propulsion', ['catalytic', 'rolling'])
@pytest.mark.parametrize('effect', EFFECTS)
def test_whatever_was_discovered_a_controller_answers(effect, propulsion):
    model = Model(LIMIT, propulsion, (some(EFFECTS[effect]),))
    goals = Goals(np.array([[20e-6, 10e-6], [-30e-6, 0], [0, 40e-6]]))
    for name, kind in CLASSES.items():
        manager = ControllerManager({name: kind()}, name, deadline=30.0)
        for k in range(3):
            outcome = manager.tick(controller_input(
                t=SINCE_1970 + k / 60, goals=goals, path=goals.position, model=model))
            assert outcome.result is not Result.FAULT, outcome.message
            assert np.hypot(*outcome.command.field) <= LIMIT * (1 + 1e-9)
        manager.close()


@pytest.mark.parametrize('effect', EFFECTS)
def test_plans_with_any_effect_begin_within_the_limits(effect):
    controller = Predictive()
    controller.configure(PredictiveParameters(budget_ms=30.0))
    goals = Goals(np.array([[20e-6, 10e-6], [-30e-6, 0]]))
    shown = controller_input(2, t=SINCE_1970, goals=goals, field=np.zeros(2),
                      model=Model(LIMIT, effects=(some(EFFECTS[effect]),)))
    command = controller.compute(shown)
    assert 0 < np.hypot(*command.field) <= LIMIT * (1 + 1e-9)
    assert np.isfinite(command.progress.distance)


def test_many_particles_are_planned_for_in_parts():
    """A tick has no time to look at every plan for ten; over some ticks all are looked at."""
    controller = Predictive()
    controller.configure(PredictiveParameters())
    shown = controller_input(10, model=Model(LIMIT))
    rng = np.random.default_rng(0)
    shown = dataclasses.replace(
        shown, goals=Goals(shown.position + rng.uniform(-2e-5, 2e-5, (10, 2))))
    for _ in range(4):
        assert np.hypot(*controller.compute(shown).field) <= LIMIT * (1 + 1e-9)
    assert controller._looks == 4


def swim(obstacle, view, start, goal, seconds):
    """One particle under `predictive` in a world of Langevin physics; where it was (T, 2) [m]."""
    fluid, radius = Fluid(viscosity=1.245e-3), np.array([2.3e-6])
    moment = rotational_drag(fluid, radius) / (5e-4 * LIMIT)
    speed, phi = np.array([4e-6]), np.array([0.8])
    world = World(bodies(fluid, radius, moment, phi, np.array([start]), speed=speed),
                  np.random.default_rng(3))
    looks = itertools.count(0, 0.016)  # its budget is no matter of how busy the machine is
    controller = Predictive(clock=lambda: next(looks))
    controller.configure(PredictiveParameters(
        obstacles_um=(np.array(obstacle) * 1e6).tolist(), margin_um=2.0, budget_ms=100.0))
    manager = ControllerManager({'it': controller}, 'it', deadline=30.0)
    times, fields, places, dt = [-1.0], [np.zeros(2)], [], 1 / 20
    for k in range(round(seconds / dt)):
        world.advance(k * dt, FieldHistory(np.array(times), np.array(fields)[:, None]))
        outcome = manager.tick(controller_input(
            1, t=k * dt, dt=dt, age=0.0, delay=0.0, position=world.position.copy(),
            theta=world.heading.copy(), speed=speed, phi=phi, workspace=view,
            goals=Goals(np.array([goal])), model=Model(LIMIT)))
        assert outcome.result is Result.OK, outcome.message
        times.append(k * dt)
        fields.append(outcome.command.field)
        places.append(world.position[0].copy())
    return np.array(places)


def test_in_true_physics_an_obstacle_is_gone_round_within_a_narrow_view():
    centre, radius = np.array([0.0, 2e-6]), 9e-6
    view = dataclasses.replace(VIEW, low=np.array([-40e-6, -20e-6]), high=np.array([40e-6, 12e-6]))
    places = swim([*centre, radius], view, (-28e-6, 0.0), (28e-6, 2e-6), 25)
    assert np.hypot(*(places[-40:] - [28e-6, 2e-6]).T).mean() < 3e-6
    assert np.hypot(*(places - centre).T).min() > radius
    assert view.holds(places).all()


def test_who_can_not_be_driven_by_it_is_said():
    with pytest.raises(ControllerError, match='rollers'):
        Predictive().activate(controller_input(model=Model(LIMIT, 'rolling')))
