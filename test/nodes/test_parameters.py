"""Settings check themselves; ROS parameters made of them refuse whole and change whole."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
import rclpy
from hypothesis import given
from hypothesis import strategies as st
from rclpy.parameter import Parameter

from microbot_ros.common import settings
from microbot_ros.common.errors import InputError
from microbot_ros.common.settings import setting
from microbot_ros.nodes.base.parameters import ParameterSet, refuse_unknown
from microbot_ros.nodes.base.transport import BY_PROFILE, NODE, transport


@dataclass(frozen=True)
class Sample:
    """One of each kind."""

    rate_hz: float = setting(60.0, 'A rate.', lower=1.0, upper=200.0)
    count: int = setting(3, 'A count.', lower=1, upper=9)
    name: str = setting('a', 'A choice.', choices=('a', 'b'))
    on: bool = setting(True, 'A switch.')
    angles_rad: list[float] = setting([0.0], 'A list.', lower=-4.0, upper=4.0)
    limit_A: float = setting(1.0, 'A safety limit.', lower=0.0, upper=2.0, read_only=True)


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_a_number_is_taken_within_its_range_only(value: float) -> None:
    if 1.0 <= value <= 200.0:
        assert settings.convert(Sample, 'rate_hz', value) == value
    else:
        with pytest.raises(ValueError, match='rate_hz must be'):
            settings.convert(Sample, 'rate_hz', value)


@pytest.mark.parametrize(('name', 'value'), [
    ('rate_hz', '60'), ('rate_hz', True), ('count', 3.0), ('count', True), ('count', 10),
    ('name', 'c'), ('name', 1), ('on', 1), ('angles_rad', 'x'), ('angles_rad', [0.0, math.nan]),
    ('angles_rad', [5.0]), ('rate_hz', None),
])
def test_a_value_of_another_kind_is_refused(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f'^{name} must be .*; received'):
        settings.convert(Sample, name, value)


def test_a_whole_number_is_taken_where_a_float_is_meant() -> None:
    assert settings.convert(Sample, 'rate_hz', 50) == 50.0
    assert settings.convert(Sample, 'angles_rad', [1, 2.5]) == [1.0, 2.5]


@pytest.fixture
def node(request: pytest.FixtureRequest) -> Iterator[rclpy.node.Node]:
    """A node with the overrides that the test asks for by indirect parametrisation."""
    overrides = [part for pair in getattr(request, 'param', []) for part in ('-p', pair)]
    context = rclpy.Context()
    with transport(BY_PROFILE, NODE):
        rclpy.init(args=['--ros-args', *overrides], context=context)
        made = rclpy.create_node('sample', context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


def test_a_change_is_taken_whole_or_not_at_all(node: rclpy.node.Node) -> None:
    held: ParameterSet[Sample] = ParameterSet(
        node, Sample, lambda new: 'b needs a count above 3' if new.name == 'b' and new.count <= 3
        else '')
    before = held.values
    refused = node.set_parameters_atomically([
        Parameter('rate_hz', value=30.0), Parameter('name', value='b')])
    assert (refused.successful, refused.reason) == (False, 'b needs a count above 3')
    assert held.values is before
    assert node.set_parameters_atomically([
        Parameter('count', value=4), Parameter('name', value='b')]).successful
    assert (held.values.count, held.values.name) == (4, 'b')


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, 0.999, 200.001, '30'])
def test_ros_refuses_what_the_setting_refuses(node: rclpy.node.Node, value: Any) -> None:
    held: ParameterSet[Sample] = ParameterSet(node, Sample)
    before = held.values
    answer = node.set_parameters([Parameter('rate_hz', value=value)])[0]
    assert not answer.successful
    assert answer.reason
    assert held.values == before


def test_a_safety_limit_is_fixed_once_the_node_runs(node: rclpy.node.Node) -> None:
    held: ParameterSet[Sample] = ParameterSet(node, Sample)
    assert not node.set_parameters([Parameter('limit_A', value=2.0)])[0].successful
    assert held.values.limit_A == 1.0


@pytest.mark.parametrize('node', [['rate_hz:=50', 'angles_rad:=[1.0,2.0]']], indirect=True)
def test_overrides_arrive_in_the_type_that_is_meant(node: rclpy.node.Node) -> None:
    values = ParameterSet(node, Sample).values
    assert (values.rate_hz, values.angles_rad) == (50.0, [1.0, 2.0])


@pytest.mark.parametrize('node', [['angles_rad:=[]']], indirect=True)
def test_an_empty_list_is_one(node: rclpy.node.Node) -> None:
    assert ParameterSet(node, Sample).values.angles_rad == []


@pytest.mark.parametrize('node', [['rate_hz:=500.0']], indirect=True)
def test_an_override_out_of_range_is_one_clear_line(node: rclpy.node.Node) -> None:
    with pytest.raises(InputError, match=r'rate_hz must be 1 to 200 Hz; received 500'):
        ParameterSet(node, Sample)


@pytest.mark.parametrize('node', [['rate_khz:=1.0']], indirect=True)
def test_a_misspelt_override_is_refused(node: rclpy.node.Node) -> None:
    ParameterSet(node, Sample)
    with pytest.raises(InputError, match=r"unknown parameter 'rate_khz'; known are: .*rate_hz"):
        refuse_unknown(node)


@dataclass(frozen=True)
class Part:
    """Of what runs in the same node."""

    gain: float = setting(1.0, 'A gain.', lower=0.0, upper=9.0)


@pytest.mark.parametrize(('changes', 'refuses', 'asked'), [
    ({'rate_hz': 30.0, 'part.gain': 2.0}, '', [{'', 'part.'}]),
    ({'part.gain': 2.0}, '', [{'part.'}]),
    ({'rate_hz': 60.0, 'part.gain': 1.0}, '', [set()]),
    ({'rate_hz': 30.0, 'part.gain': -1.0}, '', []),
    ({'rate_hz': 300.0, 'part.gain': 2.0}, '', []),
    ({'rate_hz': 30.0, 'part.gain': 7.0}, '', []),
    ({'name': 'b', 'part.gain': 2.0}, '', []),
    ({'rate_hz': 30.0, 'part.gain': 2.0, 'limit_A': 2.0}, '', []),
    ({'rate_hz': 30.0, 'part.gain': 2.0, 'use_sim_time': 'yes'}, '', []),
    ({'rate_hz': 30.0, 'part.gain': 2.0}, 'not now', [{'', 'part.'}]),
])
def test_sets_of_one_node_are_taken_together_or_not_at_all(
        node: rclpy.node.Node, changes: dict[str, Any], refuses: str,
        asked: list[set[str]]) -> None:
    handed: list[dict[str, Any]] = []
    named: list[set[str]] = []

    def take(changed: Any, names: Any) -> str:
        if names <= {*changes}:  # not while they are declared
            handed.append(dict(changed))
            named.append(set(names))
        return refuses if changed else ''

    whole: ParameterSet[Sample] = ParameterSet(
        node, Sample, lambda new: 'no b' if new.name == 'b' else '', take=take)
    part: ParameterSet[Part] = ParameterSet(
        node, Part, lambda new: 'too much' if new.gain > 6 else '', 'part.', beside=whole)
    handed.clear()
    named.clear()
    before = {name: node.get_parameter(name).value for name in changes}
    answer = node.set_parameters_atomically([
        Parameter(name, value=value) for name, value in changes.items()])
    assert [set(changed) for changed in handed] == asked
    assert named == [set(changes)] * len(asked)
    taken = bool(asked) and not refuses
    assert answer.successful == taken
    assert answer.reason or taken
    expected = changes if taken else before
    assert {name: node.get_parameter(name).value for name in changes} == expected
    assert whole.values.rate_hz == expected.get('rate_hz', 60.0)
    assert part.values.gain == expected.get('part.gain', 1.0)
