"""The package in the documentation brings an effect: it is filmed, found, kept and steered by."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from installed import install

pytestmark = pytest.mark.rig

DOCS = Path(__file__).parents[2] / 'docs'
EXAMPLE = DOCS / 'examples/my_effects'
SCENARIO = """
physics: {physics}
duration_s: 30
radius_um: 2.3
reference_field_mT: 5.0
fluid: {{viscosity_mPa_s: 1.245}}
camera: {{frame_rate_hz: 20, localisation_um: 0.1}}
commands: {{steps: {{field_mT: 5.0, dwell_s: [1, 4]}}}}
"""
PARTICLES = """
particles:
  - {x_um: -40, y_um: 20, v_um_s: 4, phi_rad: -1.1}
  - {x_um: 30, y_um: 30, v_um_s: 5, phi_rad: 2.6}
  - {x_um: 10, y_um: -40, v_um_s: 4.5, phi_rad: 0.4}
"""
THERE = 'effects: {light_gradient: {east: 0.9, north: -0.4}}\n'
KIT = """
from my_effects.light_gradient import LightGradient
from microbot_ros.conformance import exercise
exercise(LightGradient)
"""
USE = """
import sys
import numpy as np
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.contract import Goals
from microbot_ros.control.registry import controller_class
from microbot_ros.control.testkit import controller_input
from microbot_ros.loop.model import ModelParameters, ModelStage
from microbot_ros.model.io.model_file import read_model
model, particles = read_model(sys.argv[1])
effect, = model.effects
print(type(effect).__module__, effect.east, effect.north)
ModelStage(ModelParameters()).use(sys.argv[1])
for name in ('waypoint', 'predictive'):
    manager = ControllerManager({name: controller_class(name)()}, name, deadline=30.0)
    shown = controller_input(2, goals=Goals(np.array([[2e-5, 1e-5], [-3e-5, 0]])), model=model)
    outcome = manager.tick(shown)
    print(outcome.result.name)
    manager.close()
"""


@pytest.fixture(scope='module')
def installed(tmp_path_factory):
    """A folder on the path of Python with the example in it, as an installer leaves it."""
    return install(EXAMPLE, 'my_effects', tmp_path_factory.mktemp('site'))


def python(site, *arguments):
    path = os.pathsep.join([str(site), os.environ.get('PYTHONPATH', '')])
    return subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True,
                          timeout=110, env={**os.environ, 'PYTHONPATH': path}, check=False)


def microbot(site, *arguments):
    run = python(site, '-m', 'microbot_ros.cli', *arguments)
    assert run.returncode == 0, run.stderr
    return run


def test_the_example_passes_the_kit(installed):
    run = python(installed, '-c', KIT)
    assert run.stderr == ''


def test_it_is_simulated_found_kept_and_used(installed, tmp_path):
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text(SCENARIO.format(physics='langevin') + PARTICLES + THERE)
    microbot(installed, 'simulate', scenario, '--out', tmp_path / 'session')
    microbot(installed, 'discover', tmp_path / 'session', '--out', tmp_path / 'found')
    found = json.loads((tmp_path / 'found/result.json').read_text())
    assert [(e['id'], e['status']) for e in found['effects']] == [
        ('light_gradient', 'established')]
    report = (tmp_path / 'found/report.html').read_text()
    assert 'Particles are faster on one side of the picture.' in report

    run = python(installed, '-c', USE, tmp_path / 'found/model.yaml')
    assert run.stderr == ''
    (module, east, north), *results = (line.split() for line in run.stdout.splitlines())
    assert module == 'my_effects.light_gradient'
    assert float(east) == pytest.approx(0.9, abs=0.2)
    assert float(north) == pytest.approx(-0.4, abs=0.2)
    assert ['FAULT'] not in results
    assert len(results) == 2

    for physics in ('langevin', 'first_order'):
        scenario.write_text(SCENARIO.format(physics=physics) + 'model: found/model.yaml\n')
        microbot(installed, 'simulate', scenario, '--out', tmp_path / f'again_{physics}')


def test_physics_of_the_world_that_it_describes_is_found_too(installed, tmp_path):
    """A truth that shares no code with the effect: a speed that doubles over 100 µm."""
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text(SCENARIO.format(physics='langevin') + PARTICLES
                        + 'effects: {speed_by_place: {length_um: 100}}\n')
    microbot(installed, 'simulate', scenario, '--out', tmp_path / 'session')
    microbot(installed, 'discover', tmp_path / 'session', '--out', tmp_path / 'found',
             '--jobs', 2)
    effect, = json.loads((tmp_path / 'found/result.json').read_text())['effects']
    assert effect['id'] == 'light_gradient'
    assert effect['status'] == 'established'
    east = effect['parameters']['east']
    assert east['value'] == pytest.approx(1.0, abs=4 * east['std'])
    assert east['std'] < 0.15


@pytest.mark.parametrize(('effects', 'complaint'), [
    ('{light_gradient: {west: 1.0}}', "west': unknown parameter of light_gradient; known are ea"),
    ('{light_gradient: {east: 3.0, north: 0.0}}', 'less than or equal to 2'),
    ('{light_gradient: {east: [1.0, 1.0, 1.0], north: 0.0}}', 'a finite number'),
    ('{gravity: {g: 1.0}}', "unknown effect 'gravity'; expected one of: uniform_drift.*light_gra"),
])
def test_what_it_cannot_be_is_one_line(installed, tmp_path, effects, complaint):
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text(SCENARIO.format(physics='langevin') + PARTICLES + f'effects: {effects}\n')
    run = python(installed, '-m', 'microbot_ros.cli', 'simulate', scenario, '--out',
                 tmp_path / 'session')
    assert run.returncode == 2
    line, = run.stderr.splitlines()
    assert re.match(rf'microbot: .*scenario.yaml:\d+: .*{complaint}', line)


def test_the_worlds_for_training_refuse_it(installed, tmp_path):
    pytest.importorskip('gymnasium')
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text(SCENARIO.format(physics='langevin') + PARTICLES + THERE)
    run = python(installed, '-c', 'import sys; from microbot_ros.gym.worlds import SteeredWorlds;'
                 'SteeredWorlds(1, sys.argv[1], None, None)', scenario)
    assert run.stderr.splitlines()[-1].endswith(
        "scenario.yaml: 'effects': expected effects of the physics, not light_gradient of "
        'another package')


@pytest.mark.parametrize('kind', [
    PARTICLES + 'effects: {uniform_drift: {wx_um_s: 1, wy_um_s: 0}}\n', 'model: model.yaml\n'])
def test_a_package_that_does_not_load_ends_a_command_with_one_line(installed, tmp_path, kind):
    site = tmp_path / 'site'
    shutil.copytree(installed, site)
    (site / 'my_effects/light_gradient.py').write_text('import nothing_of_that_name\n')
    model = tmp_path / 'model.yaml'
    model.write_text('reference_field_mT: 5.0\neffects: {uniform_drift: {wx_um_s: 1, wy_um_s: 0}}')
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text(SCENARIO.format(physics='first_order') + kind)
    run = python(site, '-m', 'microbot_ros.cli', 'simulate', scenario, '--out', tmp_path / 'out')
    assert run.returncode == 2
    line, = run.stderr.splitlines()
    assert line.startswith("microbot: effect 'light_gradient' of my_effects 0.1.0: expected "
                           "'my_effects.light_gradient:LightGradient' to load; ModuleNotFound")
