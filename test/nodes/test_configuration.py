"""A rig's file is checked before anything starts; errors name file, line, key, expectation."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml

from microbot_ros.common.errors import InputError
from microbot_ros.nodes.base.names import NODES
from microbot_ros.nodes.configuration import node_class, read_rig, refused

ROOT = Path(__file__).parents[2]


def test_the_rig_that_is_shipped_is_sound() -> None:
    rig = read_rig(ROOT / 'config' / 'rig.yaml')
    assert list(rig) == ['camera', 'tracker', 'model', 'controller', 'coil_driver', 'recorder']
    assert rig['coil_driver']['command_timeout_ms'] == 75.0


def test_nested_keys_are_those_with_dots(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text('controller:\n  ros__parameters:\n    waypoint:\n      arrival_um: 3\n')
    assert read_rig(file) == {'controller': {'waypoint.arrival_um': 3.0}}


def test_who_asks_for_no_measurement_gets_an_amplifier_without(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text('model:\n  ros__parameters: {field_source: command}\n'
                    'coil_driver:\n  ros__parameters: {amplifier: sabertooth}\n')
    assert read_rig(file)['coil_driver'] == {'amplifier': 'sabertooth'}


@pytest.mark.parametrize(('text', 'line', 'expected'), [
    ('coil_diver:\n  ros__parameters: {}\n', 1, "unknown node 'coil_diver'; known are: camera"),
    ('tracker:\n  ros__parameters:\n    pixel_size_mm: 1.0\n', 3,
     "unknown parameter 'pixel_size_mm' of tracker; known are: example_kind, field_source"),
    ('controller:\n  ros__parameters:\n    waypoint.arival_um: 3\n', 3,
     "unknown parameter 'waypoint.arival_um' of controller; nearest of "),
    ('controller:\n  ros__parameters:\n    controller: waypiont\n', 3,
     "controller: no controller 'waypiont' is installed; there are: ensemble, "),
    ('coil_driver:\n  ros__parameters:\n    amplifier: sabretooth\n', 3,
     'coil_driver: amplifier: expected one of modbus, '),
    ('controller:\n  ros__parameters:\n    open_loop:\n      durations_s: [1, two]\n', 4,
     "durations_s must be a list of numbers; received [1, 'two']"),
    ('recorder:\n  ros__parameters:\n    topics: [1, 2]\n', 3,
     'topics must be a list of texts; received [1, 2]'),
    ('tracker:\n  ros__parameters:\n    pixel_size_um: -1.0\n', 3,
     'pixel_size_um must be 0.001 to 100 µm; received -1'),
    ('tracker:\n  ros__parameters:\n    pixel_size_um: .nan\n', 3, 'must be finite'),
    ('model:\n  ros__parameters:\n    field_source: none\n', 3,
     'field_source must be one of applied, command; received none'),
    ('tracker:\n  ros__parameters:\n    pixel_size_um: wide\n', 3, 'must be a number'),
    ('tracker:\n  parameters: {}\n', 2, "unknown key 'tracker.parameters'"),
    ('controller:\n  ros__parameters:\n    max_field_mT: 8.0\ncoil_driver:\n'
     '  ros__parameters: {}\n', 3, 'max_field_mT is 8, expected at most 5, the full_field_mT'),
    ('model:\n  ros__parameters: {}\ncoil_driver:\n  ros__parameters: {amplifier: sabertooth}\n',
     2, 'model: field_source is applied, expected command: sabertooth measures no currents'),
    ('tracker:\n  ros__parameters:\n    field_source: applied\ncoil_driver:\n'
     '  ros__parameters: {amplifier: sabertooth}\n', 3, 'tracker: field_source is applied'),
    ('- tracker\n', 1, 'expected a mapping (key: value)'),
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


_WRONG = ('x' * 999, ['x' * 999], {'x' * 999: 1}, {'a': 'x' * 999}, [1, ['x' * 999]],
          9**300, None, math.nan)


def problem_of(file: Path) -> str:
    """What is said of a rig's file; '' where it is sound."""
    try:
        read_rig(file)
    except InputError as error:
        return str(error)
    return ''


@pytest.mark.parametrize('node', NODES)
def test_no_value_of_any_parameter_is_shown_at_length(tmp_path: Path, node: str) -> None:
    file = tmp_path / 'rig.yaml'
    written = [yaml.safe_dump([value], default_flow_style=True, width=math.inf)[1:-2]
               for value in _WRONG]
    for name in node_class(node).known_parameters():
        for value, text in zip(_WRONG, written, strict=True):
            file.write_text(f'{node}: {{ros__parameters: {{{name}: {text}}}}}\n')
            said = problem_of(file)
            assert 'x' * 81 not in said
            assert len(said) < len(str(file)) + 600
            assert said or isinstance(value, str | list), f'{node}: {name} takes {value}'


@pytest.mark.parametrize(('problem', 'told'), [
    ('/dev/nowhere: expected a serial port', ':3: coil_driver: port: /dev/nowhere: expected a se'),
    ('full_scale_A is too much', ':4: coil_driver: full_scale_A is too much'),
    ('the amplifier is on fire', ':5: coil_driver: amplifier: the amplifier is on fire'),
    ('fire', ':2: coil_driver: fire'),
    (f'no {"y" * 9000}', f':5: coil_driver: amplifier: no {"y" * 79}…'),
])
def test_what_a_node_finds_is_said_where_it_stands(
        tmp_path: Path, problem: str, told: str) -> None:
    file = tmp_path / 'rig.yaml'
    parameters = {'port': '/dev/nowhere', 'full_scale_A': 2.0, 'amplifier': 'y' * 9000}
    file.write_text('coil_driver:\n  ros__parameters:\n' + ''.join(
        f'    {name}: {value}\n' for name, value in parameters.items()))
    found = refused(file, {'coil_driver': parameters}, '', 'coil_driver', problem)
    assert str(found).startswith(f'{file}{told}')


def test_a_line_is_that_of_the_rig_that_is_meant(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text(''.join(f'/{rig}/coil_driver:\n  ros__parameters:\n    port: /dev/nowhere\n'
                            for rig in ('rig_1', 'rig_2')))
    found = refused(file, read_rig(file, '/rig_2'), '/rig_2', 'coil_driver', 'no port')
    assert found.line == 6


def test_no_file_is_said() -> None:
    with pytest.raises(InputError, match=r'/nowhere\.yaml: expected a readable YAML file'):
        read_rig('/nowhere.yaml')
