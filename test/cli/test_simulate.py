"""`microbot simulate`: scenarios become sessions, and bad ones one clear line."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from microbot_ros.cli import microbot
from microbot_ros.common.errors import InputError
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.first_order import simulate
from microbot_ros.model.io.model_file import write_model
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.session import read_session

CONFIG = Path(__file__).parents[2] / 'config'
PLAIN = {
    'duration_s': 4, 'seed': 3, 'radius_um': 4.6, 'reference_field_mT': 5.0,
    'fluid': {'viscosity_mPa_s': 1.245},
    'camera': {'frame_rate_hz': 20, 'localisation_um': 0.05},
    'particles': [
        {'x_um': -60, 'y_um': 20, 'v_um_s': 3.71, 'phi_rad': -1.09},
        {'x_um': 40, 'y_um': 50, 'v_um_s': 4.38, 'phi_rad': 3.82}],
    'commands': {'steps': {'field_mT': 5.0, 'dwell_s': [0.5, 1.5]}},
}


def run(tmp_path, scenario, *options):
    path = tmp_path / 'scenario.yaml'
    path.write_text(yaml.safe_dump(scenario, sort_keys=False), encoding='utf-8')
    arguments = ['simulate', str(path), '--out', str(tmp_path / 'out'), *options]
    return CliRunner().invoke(microbot, arguments, catch_exceptions=False)


def refused(tmp_path, scenario):
    """The one line that a bad scenario earns; nothing is left behind."""
    with pytest.raises(InputError) as caught:
        run(tmp_path, scenario)
    assert {p.name for p in tmp_path.iterdir()} == {'scenario.yaml'}
    return str(caught.value).removeprefix(str(tmp_path) + '/')


def changed(**sections):
    return PLAIN | sections


@pytest.mark.parametrize('name', ['plain', 'lag'])
def test_shipped_scenarios_run(tmp_path, name):
    out = tmp_path / name
    result = CliRunner().invoke(
        microbot, ['simulate', str(CONFIG / f'scenario_{name}.yaml'), '--out', str(out)],
        catch_exceptions=False)
    assert result.exit_code == 0
    session = read_session(out)
    assert len(session.tracks.particles) == 3
    assert session.conditions.radius == pytest.approx(4.6e-6)
    truth = yaml.safe_load((out / 'truth.yaml').read_text())
    assert truth['particles'][0] == {'v_um_s': 3.71, 'phi_rad': -1.09}
    assert ('alignment_lag' in truth['effects']) == (name == 'lag')


def test_result_as_json(tmp_path):
    run(tmp_path, PLAIN, '--json', str(tmp_path / 'result.json'))
    result = json.loads((tmp_path / 'result.json').read_text())
    assert result['rows'] == 2 * 81
    assert result['particles']['1'] == {'v_um_s': 4.38, 'phi_rad': 3.82}


def test_the_same_seed_writes_the_same_files(tmp_path):
    files = []
    for place in ('first', 'second'):
        (tmp_path / place).mkdir()
        run(tmp_path / place, PLAIN)
        files.append((tmp_path / place / 'out/tracks.csv').read_bytes())
    assert files[0] == files[1]
    (tmp_path / 'third').mkdir()
    run(tmp_path / 'third', changed(seed=4))
    assert (tmp_path / 'third/out/tracks.csv').read_bytes() != files[0]


def quiet(**sections):
    return changed(camera={'frame_rate_hz': 20}, **sections)


def test_first_order_is_the_model_itself(tmp_path):
    effects = {
        'uniform_drift': {'wx_um_s': 0.5, 'wy_um_s': 0.0}, 'pixel_anisotropy': {'aspect': 1.1}}
    run(tmp_path, quiet(physics='first_order', effects=effects))
    session = read_session(tmp_path / 'out')
    times, seen = session.tracks.grid()
    model = Model(5e-3).with_effect(EFFECTS['uniform_drift'](wx=0.5e-6, wy=0.0))
    model = model.with_effect(EFFECTS['pixel_anisotropy'](aspect=1.1))
    particles = ParticleParameters(
        np.arange(2), np.array([3.71e-6, 4.38e-6]), np.array([-1.09, 3.82]))
    start = np.array([[-60e-6, 20e-6], [40e-6, 50e-6]])
    expected = model.observe(simulate(model, particles, session.commands, times, start))
    assert seen == pytest.approx(expected, abs=1e-11)


def test_newton_stokes_and_first_order_part_by_the_alignment_only(tmp_path):
    paths = []
    for physics in ('newton_stokes', 'first_order'):
        (tmp_path / physics).mkdir()
        run(tmp_path / physics, quiet(physics=physics, alignment_ms=1.0))
        paths.append(read_session(tmp_path / physics / 'out').tracks.position)
    gap = np.abs(paths[0] - paths[1]).max()
    assert 1e-10 < gap < 2e-7  # v·τ_align and more at every near-reversal


def test_model_file_brings_particles_and_effects(tmp_path):
    model = Model(5e-3, effects=(EFFECTS['speed_decay'](tau=20.0),))
    particles = ParticleParameters(
        np.array([4, 7]), np.array([4e-6, 5e-6]), np.array([0.3, -2.0]))
    write_model(tmp_path / 'model.yaml', model, particles)
    scenario = {k: v for k, v in PLAIN.items() if k != 'particles'} | {
        'model': 'model.yaml', 'effects': {'command_delay': {'delay_s': 0.1}}}
    result = run(tmp_path, scenario)
    assert result.exit_code == 0
    session = read_session(tmp_path / 'out')
    assert list(session.tracks.particles) == [4, 7]
    truth = yaml.safe_load((tmp_path / 'out/truth.yaml').read_text())
    assert truth['effects'] == {
        'speed_decay': {'tau_s': 20.0}, 'command_delay': {'delay_s': 0.1}}


def test_rollers_follow_a_frequency(tmp_path):
    particle = {'x_um': 0, 'y_um': 0, 'gain_um_s_hz': 2.0, 'phi_rad': 0.0}
    rows = [
        {'t_s': 0, 'field_mT': 5, 'direction_deg': 0, 'frequency_hz': 3},
        {'t_s': 2, 'field_mT': 5, 'direction_deg': 90, 'frequency_hz': 5}]
    run(tmp_path, quiet(
        propulsion='rolling', particles=[particle], commands={'rows': rows},
        fluid={'viscosity_mPa_s': 1000.0}))
    session = read_session(tmp_path / 'out')
    assert session.conditions.propulsion == 'rolling'
    assert session.commands.frequency == pytest.approx([3, 5])
    assert session.tracks.position[-1] * 1e6 == pytest.approx([12, 20], abs=0.3)


def test_feedback_keeps_a_record_of_its_commands(tmp_path):
    run(tmp_path, changed(commands={'herding': {'field_mT': 4.0}}))
    session = read_session(tmp_path / 'out')
    assert np.array_equal(session.commands.t, np.unique(session.tracks.t))
    assert np.hypot(*session.commands.field.T) == pytest.approx(np.full(81, 4e-3))


def closed(duration_s=4, **controller):
    """The loop closed in place of commands."""
    rest = {key: value for key, value in PLAIN.items() if key != 'commands'}
    goal = {'name': 'waypoint', 'goals_um': [[30, -20]]}
    return rest | {'duration_s': duration_s, 'controller': goal | controller}


def test_nobody_passes_a_wall(tmp_path):
    rows = [{'t_s': 0, 'field_mT': 5.0, 'direction_deg': math.degrees(1.09)}]
    wall = {'walls_um': [[-50, -100, -50, 100]], 'commands': {'rows': rows}}
    free = changed(duration_s=12, commands={'rows': rows})
    places = []
    for folder, scenario in (('free', free), ('walled', free | wall)):
        (tmp_path / folder).mkdir()
        run(tmp_path / folder, scenario)
        places.append(read_session(tmp_path / folder / 'out').tracks.of(0).position[:, 0].max())
    assert places[0] > -30e-6
    assert places[1] == pytest.approx(-54.6e-6, abs=0.5e-6)


def test_a_controller_brings_a_particle_to_its_goal(tmp_path):
    run(tmp_path, closed(25))
    session = read_session(tmp_path / 'out')
    driven = session.tracks.of(1)  # the nearer one
    assert np.hypot(*(driven.position[-1] - [30e-6, -20e-6])) < 4e-6
    assert np.hypot(*session.commands.field.T).max() == pytest.approx(5e-3, rel=1e-3)


def test_pictures_are_steered_by_what_the_tracker_finds(tmp_path):
    run(tmp_path, closed(8, pictures=True, max_field_mT=3.0))
    session = read_session(tmp_path / 'out')
    assert len(session.tracks.particles) == 2
    assert len(session.tracks.t) > 200
    assert np.isfinite(session.tracks.theta).any()
    assert np.hypot(*session.commands.field.T).max() == pytest.approx(3e-3, rel=1e-3)


def test_a_controller_has_its_own_parameters(tmp_path):
    run(tmp_path, closed(parameters={'field_mT': 2.0}, name='waypoint'))
    session = read_session(tmp_path / 'out')
    assert np.hypot(*session.commands.field.T).max() == pytest.approx(2e-3, rel=1e-3)


@pytest.mark.parametrize(('scenario', 'complaint'), [
    (closed() | {'commands': PLAIN['commands']}, "either 'commands' or 'controller'"),
    (closed() | {'physics': 'first_order'}, 'langevin physics for a controller'),
    (closed(name='steam'), "no controller 'steam'"),
    (closed(parameters={'steam': 1}), "unknown parameter 'steam' of waypoint"),
    (closed(parameters={'field_mT': float('nan')}), 'field_mT must be finite'),
    (closed() | {'camera': {'frame_rate_hz': 10}}, 'expected more than 13.3'),
    (closed(goals_um=[[1, 2, 3]]), 'controller.goals_um'),
])
def test_controllers_that_cannot_be_are_refused(tmp_path, scenario, complaint):
    assert complaint in refused(tmp_path, scenario)


@pytest.mark.parametrize(('scenario', 'culprit', 'complaint'), [
    (changed(fluid={}), 'fluid:', "expected a key 'fluid.viscosity_mPa_s'"),
    (changed(fluid={'viscosity': 1.2}), '  viscosity:',
     "unknown key 'fluid.viscosity'; expected one of: .*viscosity_mPa_s"),
    (changed(colour='red'), 'colour:', "unknown key 'colour'"),
    (changed(duration_s='nan'), 'duration_s:', 'duration_s'),
    (changed(duration_s=float('inf')), 'duration_s:', 'duration_s'),
    (changed(duration_s=0), 'duration_s:', 'duration_s'),
    (changed(radius_um=-4.6), 'radius_um:', 'radius_um'),
    (changed(height_um=4.6), 'height_um:', 'more than radius_um, 4.6'),
    (changed(height_um=float('nan')), 'height_um:', 'height_um'),
    (changed(camera={'frame_rate_hz': 20, 'missed': 1.0}), '  missed:', 'camera.missed'),
    (changed(commands={}), 'commands:', 'exactly one of: steps, rotating, herding, rows'),
    (changed(effects={'gravity': {'g_um_s': 1.0}}), '  gravity:', "unknown effect 'gravity'"),
    (changed(effects={'alignment_lag': {'tau': 0.3}}), '  alignment_lag:',
     "unknown parameter 'tau'.*tau_s"),
    (changed(effects={'alignment_lag': {'tau_s': 0.0}}), '  alignment_lag:', 'must be positive'),
    (changed(effects={'alignment_lag': {'tau_s': [0.1, 0.2, 0.3]}}), '  alignment_lag:',
     'one for each particle'),
])
def test_bad_scenarios_name_line_and_key(tmp_path, scenario, culprit, complaint):
    place, _, text = refused(tmp_path, scenario).partition(': ')
    lines = (tmp_path / 'scenario.yaml').read_text().splitlines()
    number = next(i for i, line in enumerate(lines, 1) if line.startswith(culprit))
    assert place == f'scenario.yaml:{number}'
    assert re.search(complaint, text)


@pytest.mark.parametrize(('scenario', 'complaint'), [
    (changed(particles=[]), "either 'particles' or 'model'"),
    (changed(walls_um=[[0, 5, 0, 5]]), 'two different ends'),
    (quiet(physics='first_order', walls_um=[[0, 0, 0, 5]]), 'langevin physics'),
    (changed(particles=[{'x_um': 0, 'y_um': 0, 'gain_um_s_hz': 1, 'phi_rad': 0}]),
     "expected 'v_um_s' of catalytic particle 0"),
    (changed(propulsion='rolling', particles=[
        {'x_um': 0, 'y_um': 0, 'gain_um_s_hz': 1, 'phi_rad': 0}]), "'frequency_hz'"),
    (changed(duration_s=0.09), 'at least two frames'),
    (changed(commands={'steps': {'field_mT': 5, 'dwell_s': [3, 2]}}), 'shortest, then'),
    (changed(commands={'rows': [{'t_s': 0, 'field_mT': 5, 'direction_deg': 0}] * 2}), 'ascend'),
    (changed(camera={'frame_rate_hz': 20, 'missed': 0.8, 'run': 2}), 'at least 4'),
    (quiet(physics='first_order', effects={'trap': {'speed_um_s': 1, 'length_um': 9}}),
     'effects.trap'),
    (changed(effects={'uniform_drift': {'wx_um_s': 1}}), 'uniform_drift expects also: wy_um_s'),
    (changed(effects={'command_delay': {'delay_s': -1}}), 'delay_s must not be negative'),
    (changed(effects={'pixel_anisotropy': {'aspect': 0}}), 'aspect must be positive'),
    (quiet(physics='newton_stokes', effects={'speed_decay': {'tau_s': 9}}), 'without effects'),
    (quiet(physics='first_order', commands={'herding': {'field_mT': 5}}), 'expected langevin'),
    (changed(physics='newton_stokes', camera={'frame_rate_hz': 20, 'exposure': 1}),
     'expected langevin'),
])
def test_what_does_not_go_together_is_said(tmp_path, scenario, complaint):
    assert complaint in refused(tmp_path, scenario)


def test_a_model_for_other_particles_is_refused(tmp_path):
    particles = ParticleParameters(np.array([0]), np.array([4e-6]), np.array([0.3]))
    scenario = {k: v for k, v in PLAIN.items() if k != 'particles'} | {'model': 'model.yaml'}
    write_model(tmp_path / 'model.yaml', Model(3e-3), particles)
    with pytest.raises(InputError, match=r'reference_field_mT.*expected 3'):
        run(tmp_path, scenario)
    write_model(tmp_path / 'model.yaml', Model(5e-3, 'rolling'), particles)
    with pytest.raises(InputError, match='expected rolling'):
        run(tmp_path, scenario)
    write_model(tmp_path / 'model.yaml', Model(5e-3), ParticleParameters(
        *(np.empty(0, kind) for kind in (int, float, float))))
    with pytest.raises(InputError, match='expected particles to simulate, found none'):
        run(tmp_path, scenario)


@pytest.mark.parametrize('name', ['run[a]x', 'r[', 'bold[red]'])
def test_a_folder_may_have_any_name(tmp_path, name):
    (tmp_path / 'scenario.yaml').write_text(yaml.safe_dump(PLAIN))
    done = CliRunner().invoke(microbot, [
        'simulate', str(tmp_path / 'scenario.yaml'), '--out', str(tmp_path / name)],
        catch_exceptions=False)
    assert done.exit_code == 0
    assert name in done.output.replace('\n', '')
