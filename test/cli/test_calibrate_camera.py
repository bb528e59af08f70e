"""`microbot calibrate camera`: a file ready to use, and one line for what it can't use."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from microbot_ros.cli.calibrate.calibrate import command
from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.session import write_session

_PERIOD, _ANGLE = 16.0, 0.05


@pytest.fixture(scope='module')
def lines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    y, x = np.mgrid[0:240, 0:320]
    wave = np.cos(2 * np.pi * (x * math.cos(_ANGLE) + y * math.sin(_ANGLE)) / _PERIOD)
    noise = np.random.default_rng(0).normal(0, 5, wave.shape)
    path = tmp_path_factory.mktemp('lines') / 'lines.png'
    cv2.imwrite(str(path), np.rint(120 - 50 * (wave > 0.6) + noise).astype(np.uint8))
    return path


@pytest.fixture(scope='module')
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rollers in a picture that is mirrored and turned by 0.5 rad."""
    rng = np.random.default_rng(1)
    t = np.arange(0, 12, 0.05)
    angle = np.array([0.0, 2.0, -1.5, 1.0, 3.0, -0.5])
    commands = Commands(
        np.arange(6) * 2.0, 1e-3 * np.column_stack([np.cos(angle), np.sin(angle)]),
        np.full(6, 2.0))
    steps = 4e-6 * 0.05 * np.exp(1j * angle[(t / 2).astype(int)])
    path = np.conj(np.cumsum(steps)) * np.exp(0.5j)
    places = [path + k * 20e-6 + rng.normal(0, 5e-8, len(t)) + 1j * rng.normal(0, 5e-8, len(t))
              for k in range(2)]
    z, blank = np.stack(places, axis=1).ravel(), np.full(2 * len(t), np.nan)
    tracks = Tracks(np.repeat(t, 2), np.tile([0, 1], len(t)),
                    np.column_stack([z.real, z.imag]), blank, blank)
    folder = tmp_path_factory.mktemp('session') / 'rollers'
    write_session(folder, Session(tracks, commands, Conditions('rolling')))
    return folder


def _run(*arguments: object) -> str:
    result = CliRunner().invoke(
        command, ['camera', *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_a_graticule_along_the_coils_gives_scale_and_rotation(lines: Path, tmp_path: Path) -> None:
    said = _run('--graticule', lines, '--spacing-um', 8, '--along-coils', '--out', tmp_path / 'o',
                '--json', tmp_path / 'r.json')
    written = yaml.safe_load((tmp_path / 'o' / 'camera.yaml').read_text())
    found = written['tracker']['ros__parameters']
    assert found['pixel_size_um'] == pytest.approx(8 / _PERIOD, rel=1e-3)
    assert found['rotation_deg'] == pytest.approx(math.degrees(_ANGLE), abs=0.1)
    assert 'mirrored' not in found  # nothing was said of it
    assert 'aligned with the coils' in said
    assert json.loads((tmp_path / 'r.json').read_text())['graticule']['period_px'] == \
        pytest.approx(_PERIOD, rel=1e-3)
    picture = cv2.imread(str(tmp_path / 'o' / 'calibration.png'))
    assert picture is not None


def test_tracks_give_mirroring_and_rotation_and_keep_the_scale_of_the_rig(
    session: Path, tmp_path: Path
) -> None:
    (tmp_path / 'rig.yaml').write_text(
        'tracker:\n  ros__parameters:\n    pixel_size_um: 0.33\n    mirrored: true\n')
    _run(session, '--phi-deg', 0, '--config', tmp_path / 'rig.yaml', '--out', tmp_path / 'o')
    written = yaml.safe_load((tmp_path / 'o' / 'camera.yaml').read_text())
    found = written['tracker']['ros__parameters']
    assert found['pixel_size_um'] == 0.33
    assert found['mirrored'] is False
    # z = e^{0.5i} conj(w), so that w = e^{0.5i} conj(z): the unmirrored picture stands at +0.5.
    assert found['rotation_deg'] == pytest.approx(math.degrees(0.5), abs=1.0)
    from microbot_ros.nodes.configuration import read_rig
    assert read_rig(tmp_path / 'o' / 'camera.yaml')['tracker'] == found


def test_a_rotation_that_is_not_found_stays_and_is_said(session: Path, tmp_path: Path) -> None:
    """One particle has a φ of its own; only that the picture is mirrored shows."""
    alone = tmp_path / 'alone'
    alone.mkdir()
    for path in session.iterdir():
        rows = path.read_text().splitlines(keepends=True)
        kept = [row for row in rows if path.name != 'tracks.csv' or row.split(',')[1] != '1']
        (alone / path.name).write_text(''.join(kept))
    said = _run(alone, '--out', tmp_path / 'o')
    assert 'rotation not found' in said
    found = json.loads((tmp_path / 'o' / 'calibration.json').read_text())
    assert found['mirrored'] is True
    assert found['rotation_deg'] is None
    written = yaml.safe_load((tmp_path / 'o' / 'camera.yaml').read_text())
    assert written == {'tracker': {'ros__parameters': {'mirrored': True}}}
    assert found['motion']['rotation_interval_95_deg'] is None


@pytest.mark.parametrize(('arguments', 'expected'), [
    ([], 'expected a SESSION'),
    (['--graticule', '{lines}'], '--spacing-um: expected together'),
    (['--graticule', '{lines}', '--spacing-um', 'nan'], 'positive length'),
    (['--graticule', '{lines}', '--spacing-um', 'inf'], 'positive length'),
    (['--graticule', '{lines}', '--spacing-um', '-1'], 'positive length'),
    (['--graticule', '/nowhere.png', '--spacing-um', '1'], '/nowhere.png: expected a picture'),
    (['--spacing-um', '1'], 'expected a SESSION'),
    (['{session}', '--phi-deg', 'nan'], '−180 to 180'),
    (['{session}', '--along-coils'], 'expected with --graticule'),
    (['/nowhere'], '/nowhere: expected a session'),
])
def test_bad_input_names_itself_and_leaves_nothing(
    lines: Path, session: Path, tmp_path: Path, arguments: list[str], expected: str
) -> None:
    filled = [part.format(lines=lines, session=session) for part in arguments]
    with pytest.raises(InputError, match=expected):
        _run(*filled, '--out', tmp_path / 'o')
    assert list(tmp_path.iterdir()) == []
