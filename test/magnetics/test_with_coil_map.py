"""Corrections to pairs of coils: the field at the centre is what was asked for, and no other."""

import numpy as np
import pytest
from coil_rigs import SIX

from microbot_ros.common.errors import InputError
from microbot_ros.magnetics import CoilSet, CoilSettings
from microbot_ros.magnetics.calibration import with_coil_map

GAIN, SKEW = 1.2, 0.3
MATRIX = np.array([[1, GAIN * np.sin(SKEW)], [0, GAIN * np.cos(SKEW)]])
SQUARE = [(10.0, 10.0), (-10.0, 10.0), (-10.0, -10.0), (10.0, -10.0)]


def of_polylines() -> CoilSettings:
    """The default rig with square coils."""
    content = CoilSettings().content('not none')
    for winding in content['windings']:
        axis, _ = winding.pop('axis'), winding.pop('radius_mm')
        side = np.cross((0, 0, 1), axis)
        winding['vertices_mm'] = [tuple(a * side + b * np.array((0, 0, 1.0))) for a, b in SQUARE]
    return CoilSettings.from_content(content)


@pytest.mark.parametrize('settings', [CoilSettings(), of_polylines()])
def test_the_field_of_any_currents_at_the_centre_is_turned_and_scaled(settings):
    offset = np.array([1e-4, -2e-4])
    known = settings.replaced(background_mT=(0.3, 0.1))
    corrected = CoilSet(with_coil_map(known, GAIN, SKEW, MATRIX, offset))
    before, after = (coils.actuation_matrix()[:2] for coils in (CoilSet(known), corrected))
    np.testing.assert_allclose(after, MATRIX @ before, rtol=1e-9, atol=1e-12)
    expected = offset + MATRIX @ (3e-4, 1e-4)
    np.testing.assert_allclose(corrected.background, expected, rtol=1e-12)


def test_nothing_to_correct_changes_nothing():
    settings = CoilSettings(background_mT=(0.1, -0.2))
    same = with_coil_map(settings, 1.0, 0.0, np.eye(2), np.zeros(2))
    assert same.background_mT == pytest.approx(settings.background_mT)
    assert [w.content() for w in same.windings] == [w.content() for w in settings.windings]


def test_coils_that_are_no_pairs_are_refused():
    content = CoilSettings().content('not none')
    content['windings'][1].update(position_mm=(0.0, 40.0, 0.0), axis=(0.0, 1.0, 0.0))
    with pytest.raises(InputError, match='two coils along x and two along y'):
        with_coil_map(CoilSettings.from_content(content), 1.0, 0.0, np.eye(2), np.zeros(2))


def test_coils_along_z_stay_and_measured_fields_are_not_turned(tmp_path):
    known = SIX.replaced(background_mT=(0.0, 0.0, 0.3))
    corrected = with_coil_map(known, GAIN, SKEW, MATRIX, np.zeros(2))
    before, after = (CoilSet(settings).actuation_matrix() for settings in (known, corrected))
    np.testing.assert_allclose(after[:2], MATRIX @ before[:2], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(after[:, 4:], before[:, 4:])
    assert corrected.background_mT == (0, 0, 0.3)
    line = np.array([-2.0, 2.0])
    field = np.broadcast_to((0.0, 2.0, 0.0), (2, 2, 2, 3))
    np.savez(tmp_path / 'map.npz', x_mm=line, y_mm=line, z_mm=line, field_mT_per_A=field)
    content = CoilSettings().content('not none')
    for key in ('axis', 'radius_mm', 'turns'):
        del content['windings'][0][key]
    content['windings'][0].update(field_map=tmp_path / 'map.npz', position_mm=(0, 0, 0))
    with pytest.raises(InputError, match='coil_plus_y: expected a wire'):
        with_coil_map(CoilSettings.from_content(content), GAIN, SKEW, MATRIX, np.zeros(2))
