"""A field that rotates, from its topic to what six coils carry."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from in_process import keep_commands_valid
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

from microbot_ros.cli.demo.robots import three_pairs
from microbot_ros.loop.points import ESTIMATE
from microbot_ros.magnetics import CoilSet
from microbot_ros.nodes.base import messages

B, HERTZ = 3e-3, 4.0


@pytest.fixture
def emulator_options() -> dict[str, Any]:
    """A board of six coils."""
    return {'channels': 6}


@pytest.fixture
def graph(emulator: Any, ros: Any, tmp_path: Path) -> Any:
    """A coil driver for it, armed, and who commands it."""
    coils = tmp_path / 'coils.yaml'
    coils.write_text(yaml.safe_dump({'coils': three_pairs().content()}))
    made = ros({'coil_driver': {'port': emulator.url, 'coils_file': str(coils)}})
    made.due = 0.0
    assert made.add('coil_driver').active
    keep_commands_valid(made.nodes['coil_driver'])
    made.commands = made.probe.create_publisher(Vector3Stamped, 'field/command', 10)
    made.rotating = made.probe.create_publisher(TwistStamped, 'field/rotating', 10)
    made.until(lambda: made.commands.get_subscription_count() == 1
               and made.rotating.get_subscription_count() == 1)
    made.until(lambda: made.call(SetBool, 'coil_driver/arm', SetBool.Request(data=True)).success)
    driver = made.nodes['coil_driver']._driver
    made.until(lambda: _turn(made, (0.0,) * 3, (0.0,) * 3) or not driver.gate.holding)
    return made


def _turn(graph: Any, field: tuple[float, ...], turned: tuple[float, ...],
          older: float = 0.0) -> bool:
    """Command it, 50 times a second at most, as a camera has frames; False."""
    if time.monotonic() < graph.due:
        return False
    graph.due = time.monotonic() + 0.02
    stamp = messages.to_stamp(graph.nodes['coil_driver'].seconds() - older)
    if any(turned):
        graph.rotating.publish(messages.rotating(np.array(field), np.array(turned), stamp))
    else:
        graph.commands.publish(messages.field_vector(np.array(field), stamp))
    return False


def _flowed(emulator: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and fields (K, 3) [T] at the centre, as they were commanded.

    On a busy machine the board's watchdog ends them for a moment.
    """
    entries = [entry for entry in emulator.entries() if entry['cause'] == 'command']
    field = np.array([entry['currents_A'] for entry in entries]) @ CoilSet(
        three_pairs()).actuation_matrix().T
    return np.array([entry['t_monotonic_s'] for entry in entries]), field


@pytest.mark.rig
def test_the_field_turns_about_the_axis_as_fast_as_told(graph: Any, emulator: Any) -> None:
    begun = time.monotonic()
    graph.until(lambda: time.monotonic() > begun + 2.5
                or _turn(graph, (B, 0.0, 0.0), (0.0, math.tau * HERTZ, 0.0)))
    t, field = _flowed(emulator)
    assert graph.nodes['coil_driver']._driver.gate.fault is None
    during = (t > begun + 0.5) & (t < begun + 2.4)
    t, field = t[during], field[during]
    assert np.linalg.norm(field, axis=1) == pytest.approx(B, rel=0.01)
    assert np.abs(field[:, 1]).max() < 0.01 * B
    # What is left beside the wanted turns: a busy machine may leave out more than half a turn.
    beside = np.unwrap(np.arctan2(-field[:, 2], field[:, 0]) - math.tau * HERTZ * t)
    assert np.polyfit(t, beside, 1)[0] / math.tau == pytest.approx(0.0, abs=2e-3 * HERTZ)


def test_when_the_rotation_ends_the_field_stands(graph: Any, emulator: Any) -> None:
    graph.until(lambda: not emulator.zero or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0)))
    stand = np.array([B, 0.0, 0.0])
    graph.until(lambda: np.allclose(_flowed(emulator)[1][-1], stand, atol=0.02 * B)
                or _turn(graph, (B, 0.0, 0.0), (0.0, 0.0, 0.0)))


@pytest.mark.parametrize(('field', 'turned'), [
    ((math.nan, 0, 0), (0, 1, 0)), ((B, 0, 0), (0, math.inf, 0)), ((B, 0, 0), (math.nan, 0, 0))])
def test_what_is_no_number_is_zero(
        graph: Any, emulator: Any, field: tuple[float, ...], turned: tuple[float, ...]) -> None:
    graph.until(lambda: not emulator.zero or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0)))
    graph.until(lambda: graph.nodes['coil_driver']._driver.gate.fault
                or _turn(graph, field, turned))
    graph.until(lambda: emulator.zero)


def test_a_controller_answers_in_three_axes(emulator: Any, ros: Any, tmp_path: Path) -> None:
    """By `manual`: a field that stands upright, then one whose axis is tilted (γ = 30°)."""
    coils = tmp_path / 'coils.yaml'
    coils.write_text(yaml.safe_dump({'coils': three_pairs().content()}))
    rig = ros({'coil_driver': {'port': emulator.url, 'coils_file': str(coils)},
               'controller': {'manual.field_mT': 3.0, 'manual.gamma_deg': 0.0}})
    driver, controller = rig.add('coil_driver'), rig.add('controller')
    keep_commands_valid(driver)
    states = rig.probe.create_publisher(PointCloud2, 'model/state', 10)

    def see() -> bool:
        states.publish(messages.cloud(
            np.zeros(1, ESTIMATE), messages.to_stamp(controller.seconds())))
        time.sleep(0.01)
        return False

    rig.until(lambda: states.get_subscription_count() == 1)
    rig.until(lambda: rig.call(SetBool, 'coil_driver/arm', SetBool.Request(data=True)).success)
    rig.until(lambda: not driver._driver.gate.holding or see())
    controller.set_parameters([Parameter('controller', value='manual')])
    rig.until(lambda: np.allclose(_flowed(emulator)[1][-1], [0, 0, B], atol=0.02 * B) or see())
    controller.set_parameters([Parameter('manual.frequency_hz', value=HERTZ),
                               Parameter('manual.gamma_deg', value=30.0)])
    begun = time.monotonic()
    rig.until(lambda: np.sum(_flowed(emulator)[0] > begun + 0.7) > 40 or see())
    assert driver._driver.gate.fault is None
    t, field = _flowed(emulator)
    field = field[t > begun + 0.7]
    normal = np.linalg.svd(field - field.mean(0), full_matrices=False)[2][2]
    tilt = math.degrees(math.acos(abs(normal[2])))
    assert tilt == pytest.approx(30.0, abs=0.5)
    assert np.linalg.norm(field, axis=1) == pytest.approx(B, rel=0.01)


def test_it_turns_again_after_the_clock_was_set_back(
        graph: Any, emulator: Any, monkeypatch: Any) -> None:
    driver = graph.nodes['coil_driver']
    graph.until(lambda: not emulator.zero or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0)))
    graph.until(lambda: emulator.zero or _turn(graph, (0, 0, 0), (0, 0, 0)))
    seconds = driver.seconds
    monkeypatch.setattr(driver, 'seconds', lambda: seconds() - 60.0)
    graph.until(lambda: not emulator.zero or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0)))


def test_a_rotation_of_long_ago_is_not_driven(graph: Any, emulator: Any) -> None:
    driver = graph.nodes['coil_driver']
    graph.until(lambda: driver._refused > 3
                or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0), older=5.0))
    graph.until(lambda: emulator.zero)


@pytest.mark.parametrize(('kind', 'topic'), [
    (Vector3Stamped, 'field/command'), (TwistStamped, 'field/rotating')])
def test_a_command_by_another_node_ends_the_permission(
        graph: Any, emulator: Any, kind: type, topic: str) -> None:
    graph.until(lambda: not emulator.zero or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0)))
    other = graph.nodes['coil_driver'].create_publisher(kind, topic, 10)
    driver = graph.nodes['coil_driver']._driver
    graph.until(lambda: driver.gate.fault)
    assert '2 nodes publish commands: ' in driver.gate.fault.detail
    graph.until(lambda: emulator.zero)
    graph.nodes['coil_driver'].destroy_publisher(other)


@pytest.mark.parametrize('older_s', [0.01, 1.5])
def test_a_rotation_that_was_stopped_does_not_begin_again(
        graph: Any, emulator: Any, older_s: float) -> None:
    """Two topics keep no order: the rotation of an earlier frame may come after the zero."""
    graph.until(lambda: not emulator.zero or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0)))
    driver = graph.nodes['coil_driver']
    now = driver.seconds()
    graph.commands.publish(messages.field_vector(np.zeros(3), messages.to_stamp(now)))
    graph.until(lambda: emulator.zero)
    sent = driver._driver.amplifier.counters.frames_sent
    graph.until(
        lambda: driver._driver.amplifier.counters.frames_sent > sent + 3
        or graph.rotating.publish(messages.rotating(
            np.array([B, 0.0, 0.0]), np.array([0.0, math.tau * HERTZ, 0.0]),
            messages.to_stamp(now - older_s))))
    assert emulator.zero
    graph.until(lambda: not emulator.zero or _turn(graph, (B, 0, 0), (0, math.tau * HERTZ, 0)))
