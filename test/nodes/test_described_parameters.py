"""What a page is shown of the controller's parameters, and what it may set."""

from __future__ import annotations

import array
import math
from typing import Any

import pytest
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from microbot_ros.nodes.client.described_parameters import Described

VALUES: dict[str, Any] = {
    'controller': 'hold', 'use_sim_time': False, 'model_file': '', 'policy.file': 'a.onnx',
    'max_field_mT': 5.0, 'delay_ms': 25.0, 'teleop.field_mT': 4.0, 'teleop.particle': -1,
    'hold.on': True, 'open_loop.durations_s': array.array('d', [1.0, 2.0]), 'teleop.words': ['a']}


@pytest.fixture
def described() -> Described:
    """Parameters as a controller node describes them."""
    descriptors = [ParameterDescriptor(name=name, description=f'{name}, described',
                                       read_only=name == 'max_field_mT') for name in VALUES]
    by_name = {one.name: one for one in descriptors}
    by_name['delay_ms'].floating_point_range = [FloatingPointRange(from_value=0.0, to_value=2e3)]
    by_name['teleop.particle'].integer_range = [IntegerRange(from_value=-1, to_value=7)]
    made = Described(descriptors)
    return made.with_values([VALUES[name] for name in made.names])


def test_those_of_the_manager_and_of_who_drives_are_shown(described: Described) -> None:
    shown = {one['name']: one for one in described.of('teleop')}
    assert list(shown) == ['max_field_mT', 'delay_ms', 'teleop.field_mT', 'teleop.particle',
                           'teleop.words']
    assert shown['delay_ms'] == {
        'name': 'delay_ms', 'type': 'number', 'value': 25.0, 'minimum': 0.0, 'maximum': 2000.0,
        'unit': 'ms', 'description': 'delay_ms, described', 'read_only': False}
    assert (shown['teleop.particle']['type'], shown['teleop.particle']['minimum']) == (
        'integer', -1)
    assert shown['max_field_mT']['read_only']
    assert shown['teleop.field_mT']['unit'] == 'mT'
    assert [one['value'] for one in described.of('open_loop') if 'open' in one['name']] == [
        [1.0, 2.0]]


@pytest.mark.parametrize(('name', 'value', 'as_set'), [
    ('delay_ms', 20, 20.0), ('teleop.particle', 3, 3), ('hold.on', False, False),
    ('open_loop.durations_s', [1, 2.5], [1.0, 2.5]), ('open_loop.durations_s', [], []),
    ('teleop.words', ['a', 'b'], ['a', 'b'])])
def test_values_take_their_type(described: Described, name: str, value: Any, as_set: Any) -> None:
    found = described.converted(name, value)
    assert found == as_set
    assert type(found) is type(as_set)


@pytest.mark.parametrize(('name', 'value'), [
    ('delay_ms', '20'), ('delay_ms', True), ('delay_ms', [20.0]), ('delay_ms', None),
    ('teleop.particle', 3.0), ('teleop.particle', True), ('hold.on', 1), ('hold.on', 'true'),
    ('open_loop.durations_s', 1.0), ('open_loop.durations_s', ['1']),
    ('open_loop.durations_s', [True]), ('teleop.words', 'a'), ('teleop.words', [1]),
    ('max_field_mT', 1.0), ('controller', 'teleop'), ('use_sim_time', True),
    ('model_file', '/etc/passwd'), ('policy.file', '/etc/passwd'), ('nonsense', 1)])
def test_what_is_not_shown_fixed_or_of_another_type_is_refused(
        described: Described, name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=name):
        described.converted(name, value)


def test_a_number_stays_one_when_it_is_given_as_a_whole_one(described: Described) -> None:
    described.with_values([4 if name == 'teleop.field_mT' else VALUES[name]
                           for name in described.names])
    assert described.converted('teleop.field_mT', 3) == 3.0
    assert type(described.converted('teleop.field_mT', 3)) is float
    assert math.isclose(described.converted('teleop.field_mT', 0.5), 0.5)
