"""`microbot fit` from the outside: files, table, exit codes."""

import json

import numpy as np
from click.testing import CliRunner

from microbot_ros.cli.fit import command
from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.session import write_session
from microbot_ros.virtual_rig.record_session import as_tracks


def write_example(folder):
    rng = np.random.default_rng(0)
    times, angle = np.arange(300) / 20, rng.uniform(-3, 3, 8)
    commands = Commands(np.arange(8) * 2.0, 5e-3 * np.stack([np.cos(angle), np.sin(angle)], -1))
    particles = ParticleParameters(np.arange(2), np.array([4e-6, 5e-6]), np.array([0.5, -2.0]))
    place = simulate(Model(5e-3), particles, commands, times, np.zeros((2, 2)))
    place += np.sqrt(2 * 4e-14 / 20) * np.cumsum(rng.normal(size=place.shape), axis=0)
    tracks = as_tracks(times, place + 1e-7 * rng.normal(size=place.shape))
    write_session(folder, Session(tracks, commands, Conditions(radius=4.6e-6, viscosity=1e-3)))


def test_fit_writes_json_and_figure(tmp_path):
    write_example(tmp_path / 'session')
    call = [str(tmp_path / 'session'), '--out', str(tmp_path / 'out'),
            '--json', str(tmp_path / 'copy.json')]
    result = CliRunner().invoke(command, call, catch_exceptions=False)
    assert result.exit_code == 0
    content = json.loads((tmp_path / 'out' / 'fit.json').read_text())
    assert content == json.loads((tmp_path / 'copy.json').read_text())
    assert set(content) >= {'particles', 'diffusion_um2_s', 'localisation_um', 'delay_s'}
    for name, speed, phi in (('0', 4.0, 0.5), ('1', 5.0, -2.0)):
        particle = content['particles'][name]
        for key, truth in (('v_um_s', speed), ('phi_rad', phi)):
            assert abs(particle[key]['value'] - truth) < 4 * particle[key]['std']
        force = 6 * np.pi * 1e-3 * 4.6e-6 * particle['v_um_s']['value'] * 1e6
        assert abs(particle['force_pN']['value'] - force) < 1e-9
        assert particle['one_leg']['v_um_s']['value'] > 0
    assert (tmp_path / 'out' / 'fit.png').read_bytes().startswith(b'\x89PNG')
    assert 'one leg' in result.output
