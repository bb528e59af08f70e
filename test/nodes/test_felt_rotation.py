"""Rollers roll while a field flows, whatever is commanded meanwhile."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import MagneticField, PointCloud2

from microbot_ros.loop.felt_rotation import FeltRotation
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages

OMEGA = np.array([0.0, 12.0])
FLOWS, NOTHING = np.array([0.0, 0.0, 3e-3]), np.array([2e-6, -4e-6, 3e-6])
"""A field that stands upright in this moment is one too; what noise reads is none."""


def test_without_any_reading_the_commanded_is_felt() -> None:
    t, felt = FeltRotation().command(1.0, OMEGA) or (math.nan, np.zeros(2))
    assert t == 1.0
    assert felt.tolist() == OMEGA.tolist()


def test_a_field_that_stands_ends_a_rotation_and_any_from_before_it() -> None:
    felt = FeltRotation()
    assert felt.command(0.5, np.zeros(2)) is None
    felt.command(1.0, OMEGA)
    assert felt.command(1.1, np.zeros(2)) == (1.1, pytest.approx(np.zeros(2)))
    assert felt.command(1.05, OMEGA) is None
    assert felt.command(1.2, np.zeros(2)) is None
    assert felt.command(1.3, OMEGA) == (1.3, pytest.approx(OMEGA))


def test_nothing_is_felt_while_nothing_flows() -> None:
    felt = FeltRotation()
    assert felt.applied(0.5, NOTHING) == (0.5, pytest.approx(np.zeros(2)))
    assert felt.command(1.0, OMEGA) == (1.0, pytest.approx(np.zeros(2)))
    assert felt.applied(1.1, NOTHING) is None
    t, begun = felt.applied(1.2, FLOWS) or (math.nan, np.zeros(2))
    assert (t, begun.tolist()) == (1.2, OMEGA.tolist())
    assert felt.applied(1.3, 2 * FLOWS) is None
    assert felt.command(1.4, -OMEGA) == (1.4, pytest.approx(-OMEGA))
    t, ended = felt.applied(1.5, NOTHING) or (math.nan, OMEGA)
    assert (t, ended.tolist()) == (1.5, [0.0, 0.0])


@given(st.lists(st.tuples(
    st.booleans(), st.floats(0.0, 0.5), st.sampled_from([0.0, 3e-3, math.nan, math.inf]))))
def test_what_is_felt_never_goes_back_in_time(told: list[tuple[bool, float, float]]) -> None:
    felt, last, flows = FeltRotation(), -math.inf, True
    felt.command(0.0, OMEGA)
    for commands, t, size in told:
        if commands:
            heard: Any = felt.command(t, OMEGA)
        else:
            flows = size > 0 if math.isfinite(size) else flows
            heard = felt.applied(t, np.array([0.0, size, 1e-7]))
        if heard is not None:
            assert heard[0] >= last
            assert heard[1].any() == flows
            last = heard[0]


def test_a_replay_that_begins_again_is_followed() -> None:
    felt = FeltRotation()
    felt.command(1000.0, OMEGA)
    assert felt.command(10.0, OMEGA) == (10.0, pytest.approx(OMEGA))


@pytest.mark.parametrize('t', [math.nan, math.inf, -math.inf])
def test_a_moment_that_is_none_stops_nothing(t: float) -> None:
    felt = FeltRotation()
    felt.command(t, OMEGA)
    assert felt.command(2.0, OMEGA) == (2.0, pytest.approx(OMEGA))


@pytest.mark.parametrize(('source', 'rolls'), [('applied', [False, True, False]),
                                               ('command', [True, True, True])])
def test_the_model_lets_rollers_roll_while_a_field_is_read_back(
        ros: Any, source: str, rolls: list[bool]) -> None:
    graph = ros({'model': {'propulsion': 'rolling', 'field_source': source}})
    node = graph.add('model')
    rotations = graph.probe.create_publisher(TwistStamped, 'field/rotating', 10)
    applied = graph.probe.create_publisher(MagneticField, 'field/applied', 10)
    particles = graph.probe.create_publisher(PointCloud2, 'particles', 10)
    heard = [rotations, particles, *([applied] if source == 'applied' else [])]
    graph.until(lambda: all(one.get_subscription_count() == 1 for one in heard))
    log = node.stage.estimator._log
    particles.publish(messages.cloud(np.zeros(1, PARTICLE), messages.to_stamp(1.0)))
    found = []
    for k, field in enumerate([NOTHING, FLOWS, NOTHING]):
        t, before = 2.0 + k, len(log.rows)
        # In this order on one topic each: what is told last of a field holds.
        applied.publish(messages.magnetic_field(field, messages.to_stamp(t)))
        for after in (0.1, 0.2):
            rotations.publish(messages.rotating(
                np.array([3e-3, 0.0]), np.array([*OMEGA, 0.0]), messages.to_stamp(t + after)))
        graph.until(lambda before=before: len(log.rows) >= before + 2 + (source == 'applied'))
        found.append(bool(log.rows[-1, 3]))
    assert found == rolls
