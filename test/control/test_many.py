"""Controllers of many particles: ensemble and formation reach what one field allows."""

import numpy as np
import pytest

from microbot_ros.control.contract import GoalError, Goals, ModelError, ParticleLostError
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.planning.shared import as_complex, floor
from microbot_ros.control.plugins.ensemble import Ensemble
from microbot_ros.control.plugins.formation import SHAPES, Formation, FormationParameters
from microbot_ros.control.testkit import VIEW, controller_input
from microbot_ros.model.model import Model

DT = 1 / 20


def swarm(count, seed):
    rng = np.random.default_rng(seed)
    position = rng.uniform(-50e-6, 50e-6, (count, 2))
    return position, rng.uniform(3e-6, 5e-6, count), rng.uniform(-np.pi, np.pi, count)


def drive(controller, position, speed, phi, seconds, **changes):
    """Particles that obey the first-order model without noise; their places over time."""
    manager = ControllerManager({'it': controller}, 'it', deadline=5.0)
    places, answer = [as_complex(position)], speed * np.exp(1j * phi)
    for k in range(round(seconds / DT)):
        now = np.stack([places[-1].real, places[-1].imag], -1)
        outcome = manager.tick(controller_input(
            len(speed), t=k * DT, dt=DT, age=0.0, delay=0.0, position=now, speed=speed, phi=phi,
            **changes))
        field = complex(*outcome.command.field)
        places.append(places[-1] + (answer * field / abs(field) if field else 0) * DT)
    return np.array(places), outcome


def rms(z):
    return float(np.sqrt(np.mean(np.abs(z) ** 2)))


@pytest.mark.parametrize('count', [1, 2, 5, 10])
def test_ensemble_ends_at_the_floor(count):
    position, speed, phi = swarm(count, count)
    goal = position + np.random.default_rng(1).uniform(-20e-6, 20e-6, (count, 2))
    lowest = floor(speed * np.exp(1j * phi), as_complex(goal - position))
    places, outcome = drive(Ensemble(), position, speed, phi, 10, goals=Goals(goal))
    left = [rms(z - as_complex(goal)) for z in places[-40:]]
    assert np.mean(left) <= np.hypot(lowest, 1.1e-6)
    assert np.min(left) >= lowest - 1e-9
    assert outcome.command.progress.done
    assert f'{lowest * 1e6:.1f} µm at best' in outcome.message


def test_ensemble_keeps_everybody_in_view():
    """The best displacement would carry the second particle far beyond the border."""
    position = np.array([[-100e-6, 0], [110e-6, 0], [0, 0]])
    goal = position + np.array([[90e-6, 0], [0, 0], [90e-6, 0]])
    places, _ = drive(Ensemble(), position, np.full(3, 4e-6), np.zeros(3), 20, goals=Goals(goal))
    assert places.real.max() <= VIEW.high[0]
    assert places[-1].real == pytest.approx([-71e-6, 139e-6, 29e-6], abs=2e-6)


def test_ensemble_waits_for_goals_and_for_phi_and_reports_the_lost():
    ensemble = Ensemble()
    assert 'waiting' in ensemble.compute(controller_input()).progress.message
    goals = Goals(np.zeros((2, 2)))
    unknown = controller_input(goals=goals, phi_std=np.full(3, np.inf))
    assert 'learns' in ensemble.compute(unknown).progress.message
    with pytest.raises(ParticleLostError):
        ensemble.compute(controller_input(goals=Goals(np.zeros((1, 2)), np.array([9]))))
    with pytest.raises(GoalError):
        ensemble.compute(controller_input(goals=Goals(np.full((1, 2), np.nan))))
    with pytest.raises(ModelError):
        ensemble.activate(controller_input(model=Model(5e-3, 'rolling')))


def form(shape, count=4, seed=3, seconds=15, **changes):
    position, speed, phi = swarm(count, seed)
    formation = Formation()
    formation.configure(FormationParameters(shape=shape, spacing_um=15.0))
    places, outcome = drive(formation, position, speed, phi, seconds, **changes)
    return places, speed * np.exp(1j * phi), outcome


def test_gather_reaches_the_smallest_spread_there_is():
    places, answer, outcome = form('gather')
    lowest = floor(answer - answer.mean(), places[0].mean() - places[0])
    assert np.std(places[-1]) <= np.hypot(lowest, 1.1e-6)
    assert outcome.command.progress.done


def test_spread_beats_every_direction_tried():
    places, answer, _ = form('spread', seconds=40)
    view = VIEW.high - 5e-6
    angle, length = np.meshgrid(np.linspace(0, 2 * np.pi, 72), np.linspace(0, 80, 161))
    z = places[0] + answer * (length * np.exp(1j * angle))[..., None]
    seen = ((np.abs(z.real) <= view[0]) & (np.abs(z.imag) <= view[1])).all(-1)
    assert np.std(places[-1]) >= np.std(z[seen], axis=-1).max() - 1.5e-6


def test_carry_moves_the_centre_towards_the_goal_and_costs_shape_only_where_it_must():
    goal = np.array([[10e-6, -10e-6]])
    places, answer, _ = form('carry', goals=Goals(goal))
    shape = places[0] - places[0].mean()
    wanted = shape + as_complex(goal)[0]
    lowest = floor(answer, wanted - places[0])
    assert rms(wanted - places[-1]) <= np.hypot(lowest, 1.2e-6)
    idle = Formation()
    idle.configure(FormationParameters(shape='carry'))
    assert 'waiting' in idle.compute(controller_input()).progress.message


@pytest.mark.parametrize('shape', ['line', 'ring', 'grid'])
def test_two_particles_can_make_every_shape(shape):
    """Two places have four dimensions; centre and rotation are free, and one field gives two."""
    places, _, outcome = form(shape, count=2, seed=5)
    assert abs(places[-1][0] - places[-1][1]) == pytest.approx(15e-6, abs=2.5e-6)
    assert outcome.command.progress.done


def test_a_formation_gets_nearer_and_settles():
    for shape in SHAPES[3:]:
        _, _, outcome = form(shape, count=5, seed=8, goals=Goals(np.zeros((1, 2))))
        assert outcome.command.progress.done
