"""Coils found from tracks of swimmers of the Langevin physics, under coils that are not right."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from microbot_ros.cli.calibrate.calibrate import command
from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions
from microbot_ros.discovery.check.coil_map import coil_map
from microbot_ros.magnetics import CoilSet, CoilSettings
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.session import write_session
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

GAIN, SKEW, BACKGROUND = 1.15, 0.08, np.array([0.2e-3, -0.1e-3])
COILS = {
    'coil_gain_mismatch': {'gain_ratio': GAIN}, 'coil_misalignment': {'skew_rad': SKEW},
    'background_field': {'bx_mT': 0.2, 'by_mT': -0.1}}
TRUE_MATRIX = np.array([[1, GAIN * np.sin(SKEW)], [0, GAIN * np.cos(SKEW)]])


@pytest.fixture(scope='module')
def session(film):
    return film(1, COILS, duration=60.0)[0]


def test_gain_lean_and_background_are_found_within_their_uncertainty(film):
    off = []
    for seed in range(6):
        found = coil_map(film(seed, COILS, duration=60.0)[0])
        off.append([(found.gain_ratio.value - GAIN) / found.gain_ratio.std,
                    (found.skew.value - SKEW) / found.skew.std,
                    *(found.offset - BACKGROUND) / found.offset_std])
        assert found.matrix == pytest.approx(TRUE_MATRIX, abs=0.07)
        assert found.unexplained == ()
    assert np.abs(off).max() < 4.5
    assert np.mean(np.square(off)) == pytest.approx(1, abs=0.7)


def test_the_fitted_field_explains_the_deviations(session):
    found = coil_map(session)
    seen = found.deviations
    residual = (seen.deviation - found.expected(seen.commanded)) / seen.std
    assert np.mean(residual**2) < 2
    assert np.mean((seen.deviation / seen.std)**2) > 10


def test_a_drift_and_a_delay_are_not_taken_for_coils(film):
    beside = {'uniform_drift': {'wx_um_s': 1.0, 'wy_um_s': -0.7}, 'command_delay': {'delay_s': .1}}
    found = coil_map(film(5, {**COILS, **beside}, duration=60.0)[0])
    assert abs(found.gain_ratio.value - GAIN) < 4 * found.gain_ratio.std
    assert abs(found.skew.value - SKEW) < 4 * found.skew.std


def commanded(session, field):
    return replace(session, commands=replace(session.commands, field=field))


@pytest.mark.parametrize('mistake', ['one pair reversed', 'columns swapped'])
def test_a_mirrored_command_is_refused(session, mistake):
    field = session.commands.field
    wrong = field * [1, -1] if mistake == 'one pair reversed' else field[:, ::-1]
    with pytest.raises(InputError, match='film-1: expected particles that turn with the command'):
        coil_map(commanded(session, wrong))


@pytest.mark.parametrize('seed', [4, 5, 6])
@pytest.mark.parametrize('directions', [
    (0.0,), (0.0, np.pi), (0.0, np.pi / 2), (0.0, np.pi / 2, np.pi, -np.pi / 2)])
def test_directions_that_do_not_tell_are_refused(directions, seed):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 40.0, 2.0)
    angle = np.resize(directions, t.size)
    command = Commands(t, 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    made = draw_swarm(rng, 3, Fluid(1.245e-3), 5e-3, aligns_in=2e-5, half_extent=1e-4,
                      spacing=30e-6)
    session, _ = record_session(World(made, rng), command, Camera(20.0, 0.0, 0.1e-6), 40.0, rng,
                         Conditions('catalytic', radius=4.6e-6, viscosity=1.245e-3))
    with pytest.raises(InputError, match=r'(gain ratio|skew) .* command eight directions'):
        coil_map(session)


def test_tracks_that_do_not_follow_the_command_are_refused(session):
    wandering = np.cumsum(np.random.default_rng(0).normal(0, 1e-7, session.tracks.position.shape),
                          axis=0)
    with pytest.raises(InputError, match='film-1: expected'):
        coil_map(replace(session, tracks=replace(session.tracks, position=wandering)))


def test_rollers_are_refused(film):
    with pytest.raises(InputError, match='expected catalytic particles'):
        coil_map(film(0, rolling=True)[0])


def test_the_command_writes_coils_that_make_the_field_that_came(session, tmp_path):
    write_session(tmp_path / 'tracks', session)
    known = CoilSettings(background_mT=(0.05, 0.02))
    config = tmp_path / 'rig.yaml'
    config.write_text(yaml.safe_dump({'coils': known.content('not none')}))
    result = CliRunner().invoke(command, [
        'coils', str(tmp_path / 'tracks'), '--out', str(tmp_path / 'out'), '--config', str(config),
        '--json', str(tmp_path / 'result.json')], catch_exceptions=False)
    assert result.exit_code == 0
    assert sorted(item.name for item in (tmp_path / 'out').iterdir()) == [
        'calibration.json', 'calibration.png', 'coils.yaml']
    found = coil_map(session)
    assert json.loads((tmp_path / 'result.json').read_text())['gain_ratio']['value'] == (
        pytest.approx(found.gain_ratio.value))

    section = yaml.safe_load((tmp_path / 'out' / 'coils.yaml').read_text())['coils']
    before, after = CoilSet(known), CoilSet(CoilSettings.from_content(section))
    for wanted in 1e-3 * np.array([[3.0, 0.0], [0.0, 3.0], [-2.0, 1.0], [0.0, 0.0]]):
        currents = np.linalg.pinv(before.actuation_matrix()[:2]) @ (wanted - before.background)
        came = after.actuation_matrix()[:2] @ currents + after.background
        assert came == pytest.approx(found.matrix @ wanted + found.offset, abs=1e-8)


def test_commands_that_change_with_every_frame_leave_no_deviations_to_draw(film):
    found = coil_map(film(1, COILS, duration=60.0, dwell=(0.04, 0.05))[0])
    assert len(found.deviations.commanded) == 0
    assert found.gain_ratio.value == pytest.approx(GAIN, abs=5 * found.gain_ratio.std)
