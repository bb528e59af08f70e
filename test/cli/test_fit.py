"""`microbot fit` from the outside: files, table, exit codes."""

import json

import numpy as np
from click.testing import CliRunner
from filmed import swimmers

from microbot_ros.cli.fit import command
from microbot_ros.session import write_session
from microbot_ros.virtual_rig.record_session import Camera


def test_fit_writes_json_and_figure(tmp_path):
    session, gain = swimmers(0, 15.0, Camera(20.0, 0.0, 0.1e-6), dwell=(1.0, 3.0))
    write_session(tmp_path / 'session', session)
    call = [str(tmp_path / 'session'), '--out', str(tmp_path / 'out'),
            '--json', str(tmp_path / 'copy.json')]
    result = CliRunner().invoke(command, call, catch_exceptions=False)
    assert result.exit_code == 0
    content = json.loads((tmp_path / 'out' / 'fit.json').read_text())
    assert content == json.loads((tmp_path / 'copy.json').read_text())
    assert set(content) >= {'particles', 'diffusion_um2_s', 'localisation_um', 'delay_s'}
    for name, c in zip('012', gain, strict=True):
        particle = content['particles'][name]
        speed, phi = particle['v_um_s'], particle['phi_rad']
        assert abs(speed['value'] - 1e6 * abs(c)) < 4 * speed['std']
        assert abs(np.angle(np.exp(1j * phi['value']) / c)) < 4 * phi['std']
        force = 6 * np.pi * 1.245e-3 * 4.6e-6 * speed['value'] * 1e6
        assert abs(particle['force_pN']['value'] - force) < 1e-9
        assert particle['one_leg']['v_um_s']['value'] > 0
    assert (tmp_path / 'out' / 'fit.png').read_bytes().startswith(b'\x89PNG')
    assert 'one leg' in result.output
