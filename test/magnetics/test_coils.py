"""The rig's coils: what their settings refuse, and that gain, sign and shape reach the field."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from coil_rigs import CONFIG

from microbot_ros.common.checked import Settings, SettingsError
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings
from microbot_ros.nodes.configuration import read_rig


class Rig(Settings):
    coils: CoilSettings = CoilSettings()


def windings(**changes: object) -> list[dict]:
    """The default rig's windings as people write them, the second one changed."""
    content = CoilSettings().content('not none')['windings']
    content[1] = {key: value for key, value in {**content[1], **changes}.items()
                  if value is not None}
    return content


POINTS = np.random.default_rng(0).uniform(-3e-3, 3e-3, (30, 3))


def test_default_rig_makes_a_few_millitesla_per_ampere_and_no_gradient_at_the_centre():
    coils = CoilSet()
    matrix = coils.actuation_matrix()
    strength = 4e-7 * np.pi * 400 * 0.02**2 / (2 * (0.02**2 + 0.03**2)**1.5)
    expected = strength * np.array([[0, 1, 0, -1], [1, 0, -1, 0], [0, 0, 0, 0]])
    np.testing.assert_allclose(matrix, expected, rtol=1e-8, atol=1e-15)
    uniform = coils.gradient([1, 2, -1, -2], [[0, 0, 0]])
    assert np.abs(uniform).max() < 1e-15


def test_currents_superpose():
    coils = CoilSet()
    currents = np.array([0.3, -1.2, 2, 0.7])
    each = [coils.field(current, POINTS) for current in np.diag(currents)]
    np.testing.assert_allclose(coils.field(currents, POINTS), np.sum(each, axis=0), rtol=1e-13)
    each = [coils.gradient(current, POINTS) for current in np.diag(currents)]
    np.testing.assert_allclose(
        coils.gradient(currents, POINTS), np.sum(each, axis=0), rtol=1e-11, atol=1e-13)
    assert coils.power(currents) == pytest.approx(4.3 * (0.09 + 1.44 + 4 + 0.49))


def test_gain_and_sign_scale_one_coil():
    plain = CoilSet().field_per_ampere(POINTS)
    content = {'windings': windings(gain=0.62, sign=-1), 'background_mT': (0.02, -0.045)}
    changed = CoilSet(CoilSettings.from_content(content))
    factor = np.array([1, -0.62, 1, 1])[:, None, None]
    np.testing.assert_allclose(changed.field_per_ampere(POINTS), factor * plain, rtol=1e-13)
    np.testing.assert_allclose(changed.background, (2e-5, -4.5e-5))


@pytest.mark.parametrize(('change', 'complaint'), [
    ({'radius_mm': 0}, 'radius_mm.*greater than 0'),
    ({'radius_mm': -20}, 'radius_mm.*greater than 0'),
    ({'radius_mm': '.nan'}, 'radius_mm'),
    ({'radius_mm': '.inf'}, 'radius_mm'),
    ({'turns': 0}, 'turns.*greater than 0'),
    ({'resistance_ohm': -1}, 'resistance_ohm.*greater than 0'),
    ({'max_current_A': 0}, 'max_current_A.*greater than 0'),
    ({'max_current_A': '.nan'}, 'max_current_A'),
    ({'gain': 0}, 'gain.*greater than 0'),
    ({'sign': 0}, 'sign'),
    ({'sign': 2}, 'sign'),
    ({'axis': [0, 0, 0]}, 'expected a direction'),
    ({'axis': [0, 1]}, 'axis'),
    ({'axis': None}, 'expected radius_mm and axis, .* or one of'),
    ({'vertices_mm': [[0, 0, 0], [1, 0, 0], [0, 1, 0]]}, 'expected radius_mm and axis, .* one of'),
    ({'radius_mm': None, 'axis': None, 'vertices_mm': [[0, 0, 0], [0, 0, 0], [0, 1, 0]]},
     'no two neighbours equal'),
    ({'name': 'coil_plus_y'}, 'expected different names'),
    ({'position_mm': [0, 30, 0], 'axis': [0, -1, 0]},
     "'coil_plus_y' and 'coil_plus_x' lie in the same place"),
    ({'radius_cm': 2}, "unknown key 'coils.windings.1.radius_cm'"),
])
def test_coils_that_cannot_be_are_named_with_their_line(change, complaint, tmp_path):
    path = tmp_path / 'rig.yaml'
    text = yaml.safe_dump({'coils': {'windings': windings(**change)}}, sort_keys=False)
    path.write_text(text.replace("'.nan'", '.nan').replace("'.inf'", '.inf'))
    with pytest.raises(InputError, match=complaint) as error:
        read_yaml(path, Rig)
    assert error.value.line is not None


@pytest.mark.parametrize('count', [0, 1, 17])
def test_too_few_and_too_many_coils(count):
    many = [{**windings()[0], 'name': f'coil_{k}', 'position_mm': (0, 30 + k, 0)}
            for k in range(count)]
    with pytest.raises(SettingsError, match=f'expected 2 to 16 coils, found {count}'):
        CoilSettings.from_content({'windings': many})


def test_the_rig_of_six_coils_that_is_shipped_is_driven_by_its_coils_and_can_make_its_full_field():
    driver = read_rig(CONFIG / 'rig_six_coils.yaml')['coil_driver']
    file = CONFIG.parent / driver['coils_file']
    allocator = Allocator(CoilSet(read_yaml(file, CoilSettings)))
    needed = allocator.largest_current(1e-3 * driver['full_field_mT'])
    assert needed < driver['current_limit_A']
    for name in ('rig.yaml', 'rig_six_coils.yaml'):  # they differ in nothing but their coils
        rig = read_rig(CONFIG / name)
        rig['coil_driver']['coils_file'] = ''
        assert rig == read_rig(CONFIG / 'rig.yaml')
