"""Coils found again from readings of wires wound finer than the fitted ones."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from coil_rigs import CONFIG, SIX

from microbot_ros.cli.calibrate.calibrate import command
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.magnetics import CoilSet, CoilSettings, Loop
from microbot_ros.magnetics.calibration import calibrate, read_readings

GAIN = np.array([0.81, 1.12, -1.0, 0.93])
BACKGROUND = np.array([0.021, -0.044, 0.03])  # mT
NOISE = 0.005  # mT
PLACES = [(0, 0, 0), (3, 0, 0), (0, 3, 0), (-2, 2, 1)]  # mm
NAMES = [winding.name for winding in CoilSettings().windings]
HEADER = [*(f'{name}_A' for name in NAMES), 'x_mm', 'y_mm', 'z_mm', 'bx_mT', 'by_mT', 'bz_mT']


@cache
def per_ampere(place: tuple[float, float, float]) -> np.ndarray:
    """Field (4, 3) [T/A] of coils wound in nine layers of nine, 3 mm across, 400 turns in all."""
    point = 1e-3 * np.array([place])
    across = np.linspace(-1.5e-3, 1.5e-3, 9)
    fields = []
    for winding in CoilSettings().windings:
        centre, axis = 1e-3 * np.array(winding.position_mm), np.array(winding.axis)
        fields.append(sum(
            Loop(0.02 + out, centre + up * axis, axis, 400 / 81).field_per_ampere(point)[0]
            for out in across for up in across))
    return np.array(fields)


def rows(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    readings = []
    for place in PLACES:
        field = GAIN[:, None] * per_ampere(place) * 1e3
        for currents in np.vstack([np.eye(4), -np.eye(4), 2 * np.eye(4), np.zeros((1, 4))]):
            measured = currents @ field + BACKGROUND + rng.normal(0, NOISE, 3)
            readings.append([*currents, *place, *measured])
    return np.array(readings)


def write(path, values, header=HEADER):
    lines = [','.join(header), *(','.join(map(repr, row)) for row in np.asarray(values).tolist())]
    path.write_text('\n'.join(lines) + '\n')
    return path


def run(*arguments):
    return CliRunner().invoke(command, ['coils', *map(str, arguments)], catch_exceptions=False)


def test_gains_signs_and_background_are_found_within_their_uncertainty(tmp_path):
    # The thick winding is weaker than the fitted loop by a part that is no error of the fit.
    thickness = np.linalg.norm(per_ampere((0, 0, 0)), axis=1) / np.linalg.norm(
        CoilSet().field_per_ampere([[0, 0, 0]])[:, 0], axis=1)
    off = []
    for seed in range(20):
        path = write(tmp_path / 'readings.csv', rows(seed))
        found = calibrate(read_readings(path, CoilSettings()), CoilSettings(), path)
        off.append(np.concatenate([
            (found.gain - GAIN * thickness) / found.gain_std,
            (found.background - 1e-3 * BACKGROUND[:2]) / found.background_std]))
        assert np.nanstd(found.residuals) == pytest.approx(1e-3 * NOISE, rel=0.25)
    assert np.abs(off).max() < 4.5
    assert np.mean(np.square(off)) == pytest.approx(1, rel=0.4)


def test_readings_at_the_centre_in_any_order_of_columns_need_no_place_and_no_z(tmp_path):
    values = rows()[:13, [7, 8, 3, 2, 1, 0]]
    path = write(tmp_path / 'readings.csv', values, [HEADER[k] for k in (7, 8, 3, 2, 1, 0)])
    found = calibrate(read_readings(path, CoilSettings()), CoilSettings(), path)
    np.testing.assert_allclose(found.gain, GAIN, rtol=0.02)
    assert np.isnan(found.residuals[:, 2]).all()


def test_readings_without_noise_leave_no_doubt(tmp_path):
    currents = np.vstack([np.eye(4), -np.eye(4)])
    field = 1e3 * currents @ CoilSet().actuation_matrix().T
    path = write(tmp_path / 'readings.csv', np.column_stack([currents, field]),
                 [*HEADER[:4], *HEADER[7:]])
    found = calibrate(read_readings(path, CoilSettings()), CoilSettings(), path)
    np.testing.assert_allclose(found.gain, 1, rtol=1e-12)


def test_command_writes_a_section_that_predicts_the_readings(tmp_path):
    pytest.importorskip('matplotlib')
    path, out = write(tmp_path / 'readings.csv', rows()), tmp_path / 'out'
    assert run(path, '--out', out, '--json', tmp_path / 'result.json').exit_code == 0
    assert sorted(item.name for item in out.iterdir()) == [
        'calibration.json', 'calibration.png', 'coils.yaml']
    section = yaml.safe_load((out / 'coils.yaml').read_text())['coils']
    coils = CoilSet(CoilSettings.from_content(section))
    values = rows(seed=1)
    predicted = [1e3 * coils.field(row[:4], 1e-3 * row[None, 4:7])[0] for row in values]
    left = values[:, 7:9] - np.array(predicted)[:, :2] - 1e3 * coils.background
    assert np.sqrt(np.mean(left**2)) < 1.5 * NOISE
    summary = json.loads((tmp_path / 'result.json').read_text())
    assert [summary['coils'][name]['sign'] for name in NAMES] == [1, 1, -1, 1]

    with pytest.raises(InputError, match=r'without coils\.yaml.*--force replaces'):
        run(path, '--out', out)

    # What the file says already does not change what the readings say.
    again = run(path, '--out', tmp_path / 'again', '--config', out / 'coils.yaml')
    assert again.exit_code == 0
    assert json.loads((tmp_path / 'again' / 'calibration.json').read_text()) == summary


def swapped(one: str, other: str) -> list[str]:
    trade = {one: other, other: one}
    return [trade.get(name, name) for name in HEADER]


PAIRED = rows()
PAIRED[:, 2] = -PAIRED[:, 0]
DEAD = rows()
DEAD[:, 7:] = (DEAD[:, :4] * (1, 0, 1, 1)) @ per_ampere((0, 0, 0)) * 1e3
STUCK = rows()
STUCK[:, 7:] = 0.02
NOTHING = rows()[:0]


@pytest.mark.parametrize(('values', 'header', 'complaint'), [
    (rows(), swapped('bx_mT', 'by_mT'), 'bx_mT holds y, by_mT holds x'),
    (rows(), swapped('coil_plus_x_A', 'coil_plus_y_A'),
     'coil_plus_x_A holds the current of coil_plus_y'),
    (rows(), swapped('coil_plus_x_A', 'coil_minus_x_A'),
     'coil_plus_x_A holds the current of coil_minus_x$'),
    (rows(), swapped('coil_plus_x_A', 'bx_mT'), 'a gain between 1/3 and 3 for coil_plus_x'),
    (rows(), swapped('coil_plus_x_A', 'x_mm'), "expected readings that fit the coils' geometry"),
    (rows() * ([1e3] * 4 + [1] * 6), HEADER, 'found 0.000.* units'),
    (rows() * ([1e-3] * 4 + [1] * 6), HEADER, 'found 8.* units'),
    (PAIRED[:, [0, 1, 2, 3, 7, 8]], [*HEADER[:4], *HEADER[7:9]], 'singular'),
    (rows()[:3], HEADER, 'singular'),
    (NOTHING, HEADER, 'readings.csv:1: expected rows below the header'),
    (DEAD[:13], HEADER, 'expected a gain between 1/3 and 3 for coil_plus_x, found'),
    (STUCK, HEADER, '100% of their variation is unexplained'),
    (np.vstack([rows(), np.full(10, np.nan)]), HEADER, "readings.csv:54: .* found 'nan'"),
    (np.vstack([rows(), np.full(10, -np.inf)]), HEADER, "readings.csv:54: .* found '-inf'"),
    (rows()[:, 1:], HEADER[1:],
     'readings.csv:1: expected the header bx_mT,by_mT,.*; missing: coil_plus_y_A$'),
    (rows(), [*HEADER[:-1], 'bz_T'], 'readings.csv:1: expected the header'),
    (rows(), [*HEADER[:-1], 'by_mT'], 'readings.csv:1: expected the header'),
    (rows(), HEADER[:-1], 'readings.csv:2: expected 9 values separated by commas, found 10'),
])
def test_readings_that_say_nothing_write_nothing(values, header, complaint, tmp_path):
    path = write(tmp_path / 'readings.csv', values, header)
    with pytest.raises(InputError, match=complaint) as error:
        run(path, '--out', tmp_path / 'out')
    assert '\n' not in str(error.value)
    assert [item.name for item in tmp_path.iterdir()] == ['readings.csv']


def test_files_that_are_none(tmp_path):
    path = tmp_path / 'readings.csv'
    with pytest.raises(InputError, match='expected a readable CSV'):
        read_readings(path, CoilSettings())
    path.write_text('')
    with pytest.raises(InputError, match=r'readings.csv: expected the header .* an empty file'):
        read_readings(path, CoilSettings())
    path.write_text(','.join(HEADER) + '\n' + ','.join(['1'] * 9 + ['a bit']) + '\n')
    with pytest.raises(InputError, match=r"readings.csv:2: .* in 'bz_mT', found 'a bit'"):
        read_readings(path, CoilSettings())
    # A column that may be left out has no empty cells either: half a column says nothing.
    path.write_text(','.join(HEADER) + '\n' + ','.join(['1'] * 9 + ['']) + '\n')
    with pytest.raises(InputError, match=r"readings.csv:2: expected a number in 'bz_mT'$"):
        read_readings(path, CoilSettings())


def test_it_starts_from_the_coils_that_a_rig_names_and_says_so(tmp_path):
    readings, rig = write(tmp_path / 'readings.csv', rows()), tmp_path / 'rig.yaml'
    known = CoilSettings().content('not none')
    known['windings'][0]['turns'] = 500
    coils = tmp_path / 'known.yaml'
    rig.write_text(yaml.safe_dump({
        'camera': {'ros__parameters': {'source': 'film'}},
        'coil_driver': {'ros__parameters': {'coils_file': str(coils)}}}))
    for content in (known, {'coils': known}):  # as it is written, and without the key
        coils.write_text(yaml.safe_dump(content))
        for config, named in ((rig, f', named in {rig}'), (coils, '')):
            found = run(readings, '--config', config, '--out', tmp_path / 'out', '--force')
            assert f'started from the coils of {coils}{named}\n' in found.stdout
            section = yaml.safe_load((tmp_path / 'out' / 'coils.yaml').read_text())['coils']
            assert [winding['turns'] for winding in section['windings']] == [500, 400, 400, 400]
    assert 'started from the coils of the default rig\n' in run(
        readings, '--out', tmp_path / 'out', '--force').stdout
    rig.write_text('coil_driver:\n  ros__parameters:\n    port: /dev/ttyACM0\n')
    said = run(readings, '--config', rig, '--out', tmp_path / 'out', '--force').stdout
    assert f'started from the coils of the default rig: {rig} names no coils_file\n' in said


@pytest.mark.parametrize(('content', 'complaint'), [
    ('', 'expected coils, .* or the file of a rig, with a section coil_driver; found nothing'),
    ('camera: {}\n', 'expected coils, .* found camera'),
    ('coil_driver:\n  ros__parameters:\n    coils_file: /nowhere.yaml\n',
     '/nowhere.yaml: expected a readable YAML file'),
    ('coil_driver:\n  ros__parameters:\n    coil_file: a\n', r'rig\.yaml:3: unknown parameter'),
    ('coils:\n', r"rig\.yaml:1: 'coils'"),
    ('coils:\n  windings: []\n', r"rig\.yaml:2: 'coils\.windings': expected 2 to 16 coils"),
])
def test_a_file_without_coils_is_not_taken_for_the_default_rig(content, complaint, tmp_path):
    config = tmp_path / 'rig.yaml'
    config.write_text(content)
    with pytest.raises(InputError, match=complaint) as error:
        run(write(tmp_path / 'readings.csv', rows()), '--config', config, '--out', tmp_path / 'o')
    assert '\n' not in str(error.value)
    assert not (tmp_path / 'o').exists()


def test_what_is_wrong_in_a_file_of_coils_is_said_where_it_stands(tmp_path):
    path = tmp_path / 'coils.yaml'
    for key in ('', 'coils:'):
        path.write_text(f'{key}\n{" " * bool(key)}background_mT: [0, 0]\n'
                        f'{" " * bool(key)}winding: []\n')
        with pytest.raises(InputError, match=rf"coils\.yaml:3: unknown key '{key[:-1]}.?winding'"):
            read_yaml(path, CoilSettings)
    path.write_text('coils: {background_mT: [0, 0]}\nbackground_mT: [0, 0]\n')
    with pytest.raises(InputError, match=r"coils\.yaml:2: unknown key 'background_mT'"):
        read_yaml(path, CoilSettings)


SIX_GAIN = np.array([0.81, 1.12, -1.0, 0.93, 1.05, -0.9])
SIX_BACKGROUND = np.array([0.02, -0.03, 0.045])  # mT


def readings_of_six(tmp_path, along='xyz', order=range(6)):
    """The six coils driven one by one at the centre and beside it, with a probe of these axes."""
    coils, rng, values = CoilSet(SIX), np.random.default_rng(0), []
    for place in PLACES:
        field = 1e3 * SIX_GAIN[:, None] * coils.field_per_ampere(1e-3 * np.array([place]))[:, 0]
        for currents in np.vstack([np.eye(6), -np.eye(6), np.zeros((1, 6))]):
            measured = currents @ field + SIX_BACKGROUND + rng.normal(0, NOISE, 3)
            values.append([*currents, *place, *measured[:len(along)]])
    names = [f'{coils.names[k]}_A' for k in order]
    return write(tmp_path / 'readings.csv', values,
                 [*names, 'x_mm', 'y_mm', 'z_mm', *(f'b{axis}_mT' for axis in along)])


def test_six_coils_are_calibrated_along_three_axes(tmp_path):
    path, out = readings_of_six(tmp_path), tmp_path / 'out'
    assert run(path, '--config', CONFIG / 'coils_six.yaml', '--out', out).exit_code == 0
    found = read_yaml(out / 'coils.yaml', CoilSettings)
    assert (found.axes, found.workspace_mm) == ('xyz', 10)
    signed = [winding.gain * winding.sign for winding in found.windings]
    np.testing.assert_allclose(signed, SIX_GAIN, atol=0.01)
    np.testing.assert_allclose(found.background_mT, SIX_BACKGROUND, atol=4e-3)
    assert (out / 'calibration.png').is_file()


def test_six_coils_swapped_or_measured_along_two_axes_are_refused(tmp_path):
    path = readings_of_six(tmp_path, order=(0, 4, 2, 3, 1, 5))
    with pytest.raises(InputError, match='coil_plus_x_A holds the current of coil_plus_z'):
        calibrate(read_readings(path, SIX), SIX, path)
    path = readings_of_six(tmp_path, 'xy')
    with pytest.raises(InputError, match=r'expected the header bx_mT,by_mT,bz.*; missing: bz_mT$'):
        read_readings(path, SIX)
