"""A rig's file is checked before anything starts; errors name file, line, key, expectation."""

from __future__ import annotations

from pathlib import Path

import pytest

from microbot_ros.errors import InputError
from microbot_ros.nodes.configuration import read_rig

ROOT = Path(__file__).parents[2]


def test_the_rig_that_is_shipped_is_sound() -> None:
    rig = read_rig(ROOT / 'config' / 'rig.yaml')
    assert list(rig) == ['camera', 'tracker', 'model', 'controller', 'coil_driver', 'recorder']
    assert rig['coil_driver']['command_timeout_ms'] == 75.0


def test_nested_keys_are_those_with_dots(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text('controller:\n  ros__parameters:\n    waypoint:\n      arrival_um: 3\n')
    assert read_rig(file) == {'controller': {'waypoint.arrival_um': 3.0}}


def test_former_names_stand_for_those_of_today(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text('coil_driver:\n  ros__parameters: {stale_ms: 90, continuous_A: 1}\n'
                    'tracker:\n  ros__parameters: {drive: none}\n')
    assert read_rig(file) == {
        'coil_driver': {'command_timeout_ms': 90.0, 'max_command_age_ms': 90.0,
                        'rated_current_A': 1.0},
        'tracker': {'field_source': 'none'}}


def test_who_asks_for_no_measurement_gets_an_amplifier_without(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text('model:\n  ros__parameters: {field_source: command}\n'
                    'coil_driver:\n  ros__parameters: {amplifier: sabertooth}\n')
    assert read_rig(file)['coil_driver'] == {'amplifier': 'sabertooth'}


@pytest.mark.parametrize(('text', 'line', 'expected'), [
    ('coil_diver:\n  ros__parameters: {}\n', 1, "unknown node 'coil_diver'; known are: camera"),
    ('tracker:\n  ros__parameters:\n    pixel_size_mm: 1.0\n', 3,
     "unknown parameter 'pixel_size_mm' of tracker; known are: field_source, full_search_ms"),
    ('tracker:\n  ros__parameters:\n    pixel_size_um: -1.0\n', 3,
     'pixel_size_um must be 0.001 to 100 µm; received -1'),
    ('tracker:\n  ros__parameters:\n    pixel_size_um: .nan\n', 3, 'must be finite'),
    ('model:\n  ros__parameters:\n    command_source: none\n', 3,
     'field_source must be one of applied, command; received none'),
    ('tracker:\n  ros__parameters:\n    pixel_size_um: wide\n', 3, 'must be a number'),
    ('tracker:\n  parameters: {}\n', 2, "unknown key 'tracker.parameters'"),
    ('controller:\n  ros__parameters:\n    max_field_mT: 8.0\ncoil_driver:\n'
     '  ros__parameters: {}\n', 3, 'max_field_mT is 8, expected at most 5, the full_field_mT'),
    ('model:\n  ros__parameters: {}\ncoil_driver:\n  ros__parameters: {amplifier: sabertooth}\n',
     2, 'model: field_source is applied, expected command: sabertooth measures no currents'),
    ('tracker:\n  ros__parameters:\n    field_source: applied\ncoil_driver:\n'
     '  ros__parameters: {amplifier: sabertooth}\n', 3, 'tracker: field_source is applied'),
    ('- tracker\n', 1, 'expected keys and values'),
    ('tracker: [\n', 2, 'expected YAML'),
])
def test_what_is_wrong_is_said_where_it_stands(
        tmp_path: Path, text: str, line: int, expected: str) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        read_rig(file)
    assert str(caught.value).startswith(f'{file}:{line}: ')
    assert expected in str(caught.value)
    assert '\n' not in str(caught.value)


def test_no_file_is_said() -> None:
    with pytest.raises(InputError, match=r'/nowhere\.yaml: expected a readable YAML file'):
        read_rig('/nowhere.yaml')
