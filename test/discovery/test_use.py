"""What was discovered is used: in the simulation, in the filter, in the predictive controller."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from microbot_ros.cli import microbot
from microbot_ros.common.records import Commands
from microbot_ros.control.contract import Goals
from microbot_ros.control.plugins.predictive import Predictive, PredictiveParameters
from microbot_ros.control.testkit import controller_input
from microbot_ros.estimation.online.estimator import Estimator
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.first_order import simulate
from microbot_ros.model.io.model_file import read_model
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.session import read_session, write_session

DRIFT = {'wx_um_s': 1.2, 'wy_um_s': -0.9}


@pytest.fixture(scope='module')
def discovered(film, tmp_path_factory):
    """Where `microbot discover` left what it found, and the particles as they are."""
    folder = tmp_path_factory.mktemp('use')
    session, truth = film(31, {'uniform_drift': DRIFT}, duration=20.0)
    write_session(folder / 'session', session)
    done = CliRunner().invoke(microbot, [
        'discover', str(folder / 'session'), '--out', str(folder / 'found')])
    assert done.exit_code == 0, done.output
    return folder, session, truth


def test_the_simulation_runs_with_it(discovered):
    folder, *_ = discovered
    (folder / 'scenario.yaml').write_text(yaml.safe_dump({
        'duration_s': 4, 'seed': 1, 'model': 'found/model.yaml', 'spread_um': 80,
        'camera': {'frame_rate_hz': 20}, 'fluid': {'viscosity_mPa_s': 1.245},
        'reference_field_mT': 5.0, 'radius_um': 4.6,
        'commands': {'steps': {'field_mT': 5.0, 'dwell_s': [1, 2]}}}))
    done = CliRunner().invoke(microbot, [
        'simulate', str(folder / 'scenario.yaml'), '--out', str(folder / 'simulated')])
    assert done.exit_code == 0, done.output
    truth = yaml.safe_load((folder / 'simulated' / 'truth.yaml').read_text())
    assert truth['effects']['uniform_drift'] == pytest.approx(DRIFT, abs=0.2)
    assert len(read_session(folder / 'simulated').tracks.particles) == 3


def test_the_filter_takes_it_while_running_and_sees_speeds_as_they_are(discovered):
    folder, session, truth = discovered
    plain, told = Estimator(session.conditions), Estimator(session.conditions)
    times, positions = session.tracks.grid()
    sent, commands = 0, session.commands
    for k, t in enumerate(times):
        while sent < len(commands.t) and commands.t[sent] <= t:
            for estimator in (plain, told):
                estimator.command(commands.t[sent], commands.field[sent])
            sent += 1
        if k == 100:
            told.load(folder / 'found' / 'model.yaml')
        first, last = (e.update(t, np.arange(3), positions[k]) for e in (plain, told))
    c = truth['speed'] * np.exp(1j * truth['phi'])
    off = np.abs(last.speed * np.exp(1j * last.phi) - c)
    assert (off < 4 * last.speed_std).all()
    # What a model leaves unexplained, it takes for diffusion.
    assert last.noise.diffusion < 0.8 * first.noise.diffusion


def test_the_predictive_controller_plans_with_it(discovered):
    """Carried out in the hidden world, a plan with the model found ends at the goal."""
    folder, _, truth = discovered
    model, particles = read_model(folder / 'found' / 'model.yaml')
    world = Model(5e-3, effects=(UniformDrift(DRIFT['wx_um_s'] * 1e-6, DRIFT['wy_um_s'] * 1e-6),))
    swimmer = ParticleParameters(np.zeros(1, int), truth['speed'][:1], truth['phi'][:1])
    goal, start = np.array([[5e-5, 0.0]]), np.zeros((1, 2))
    missed = []
    for known in (Model(5e-3), model):
        controller = Predictive()
        controller.configure(PredictiveParameters(budget_ms=100.0))
        seen = controller_input(
            1, position=start, expected=start, theta=np.full(1, np.nan), delay=0.0,
            speed=particles.speed[:1], phi=particles.phi[:1], goals=Goals(goal), model=known)
        controller.activate(seen)
        controller.compute(seen)
        plan = controller._plan
        times = np.concatenate([[0.0], np.cumsum(plan.duration)])
        path = simulate(world, swimmer, Commands(times[:-1], plan.field), times, start)
        missed.append(np.hypot(*(path[-1] - goal)[0]))
    assert missed[0] > 10e-6
    assert missed[1] < 3e-6
