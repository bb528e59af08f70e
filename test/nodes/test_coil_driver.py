"""The driver against the emulated amplifier: what flows, and above all when nothing flows."""

from __future__ import annotations

import errno
import math
import time
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from in_process import FAILSAFE_S, keep_commands_valid
from sensor_msgs.msg import JointState, MagneticField, TimeReference
from std_msgs.msg import Bool, Empty
from std_srvs.srv import SetBool

from microbot_ros.common.settings import about
from microbot_ros.drive.amplifier import Counters
from microbot_ros.drive.coil_driver import STOPPED, Zero
from microbot_ros.drive.gate import Fault
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import LATCHED
from microbot_ros.nodes.coil_driver import LIMITS, CoilDriverParameters


def _start(emulator: Any, ros: Any, **parameters: Any) -> Any:
    graph = ros({'coil_driver': {'port': emulator.url, 'full_scale_A': 2.0, **parameters}})
    assert graph.add('coil_driver').active
    graph.commands = graph.talk(Vector3Stamped, 'field/command')
    return graph


def _arm(graph: Any, on: bool = True) -> Any:
    """The answer; what was armed is told a zero, as a controller does."""
    answer = graph.call(SetBool, 'coil_driver/arm', SetBool.Request(data=on))
    if on and answer.success:
        driver = graph.nodes['coil_driver']._driver
        graph.until(lambda: _command(graph, 0.0, 0.0) or not driver.gate.holding)
    return answer


def _command(graph: Any, x: float, y: float, age: float = 0.0) -> None:
    stamp = messages.to_stamp(graph.nodes['coil_driver'].seconds() - age)
    graph.commands.publish(messages.field_vector(np.array([x, y]), stamp))


def _driving(graph: Any, emulator: Any, command_timeout_s: float = FAILSAFE_S) -> None:
    keep_commands_valid(graph.nodes['coil_driver'], command_timeout_s)
    graph.until(lambda: _arm(graph).success)
    graph.until(lambda: _command(graph, 3e-3, 0.0) or not emulator.zero)


def test_a_field_that_is_commanded_is_read_back(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    fields = graph.hear(MagneticField, 'field/applied')
    latencies = graph.hear(TimeReference, 'coil_driver/latency')
    told_currents = [graph.hear(JointState, f'coils/{what}')
                     for what in ('command', 'applied', 'measured')]
    watchdog = graph.nodes['coil_driver'].health()[2]['watchdog']
    assert watchdog == 'in the firmware, if it has one: arming tests it'
    graph.until(lambda: _arm(graph).success)

    def matches() -> bool:
        _command(graph, 3e-3, -1e-3)
        now = fields[-1].magnetic_field if fields else None
        return bool(now and math.hypot(now.x - 3e-3, now.y + 1e-3) < 2e-5)
    graph.until(matches)
    graph.until(lambda: latencies)
    spent = messages.to_seconds(latencies[0].header.stamp) - messages.to_seconds(
        latencies[0].time_ref)
    assert spent > 0
    flowed = [entry['currents_A'] for entry in emulator.entries() if any(entry['currents_A'])]
    for told in told_currents:
        graph.until(lambda told=told: any(
            message.effort == pytest.approx(flowed[-1], abs=1e-3) for message in told))
    plus_y, plus_x, minus_y, minus_x = flowed[-1]
    assert plus_x == pytest.approx(-minus_x, rel=1e-3)
    assert plus_y == pytest.approx(-minus_y, rel=1e-3)
    assert plus_x > 0 > plus_y
    told = graph.nodes['coil_driver'].health()[2]
    assert told['self_check'] == 'passed, gains 1.00, 1.00, 1.00, 1.00'
    assert told['watchdog'].startswith('in the firmware, zeroed after ')
    assert told['latency_ms'] == pytest.approx(1e3 * graph.nodes['coil_driver']._latency)
    assert 0 < told['latency_ms'] < 1e3 * FAILSAFE_S


@pytest.mark.parametrize('board_turns', [False, True])
def test_the_board_turns_a_field_only_where_that_is_set(
        emulator: Any, ros: Any, board_turns: bool) -> None:
    graph = _start(emulator, ros, board_turns=board_turns)
    assert graph.nodes['coil_driver']._driver.amplifier.swings == board_turns


def test_whether_it_is_armed_is_published_on_change_and_to_late_subscribers(
        emulator: Any, ros: Any) -> None:
    """With the diagnostics that say why not, which else a timer publishes."""
    graph = _start(emulator, ros)
    for timer in graph.nodes['coil_driver'].timers:
        timer.cancel()
    told = graph.hear(Bool, 'coil_driver/armed', LATCHED)
    health = graph.hear(DiagnosticArray, '/diagnostics')
    graph.until(lambda: told)
    health.clear()
    graph.until(lambda: _arm(graph).success)
    graph.until(lambda: told[-1].data)
    graph.until(lambda: any((pair.key, pair.value) == ('armed', 'True')
                            for one in health for pair in one.status[0].values))
    graph.until(lambda: _command(graph, 3e-3, 0.0) or not emulator.zero)
    count = len(told)
    health.clear()
    graph.until(lambda: not told[-1].data)  # nobody commands any more
    graph.until(lambda: any(one.status[0].level == b'\x02' for one in health))
    graph.until(lambda: any('zero, confirmed' in one.status[0].message for one in health))
    assert [one.data for one in told[count:]] == [False]
    late = graph.hear(Bool, 'coil_driver/armed', LATCHED)
    graph.until(lambda: late)
    assert [one.data for one in late] == [False]


@pytest.mark.parametrize('field', [(math.nan, 0.0), (0.0, math.inf), (-math.inf, math.nan)])
def test_a_field_that_is_no_number_latches_zero(
        emulator: Any, ros: Any, field: tuple[float, float]) -> None:
    graph = _start(emulator, ros)
    _driving(graph, emulator)
    _command(graph, *field)
    driver = graph.nodes['coil_driver']
    graph.until(lambda: driver._driver.gate.fault)
    graph.until(lambda: emulator.zero)
    level, sentence, _ = driver.health()
    assert level == b'\x02'
    assert 'currents are not finite numbers, one per coil' in sentence
    _command(graph, 3e-3, 0.0)  # and stays latched
    sent = driver._driver.amplifier.counters
    begin = sent.frames_sent
    graph.until(lambda: sent.frames_sent > begin + 2)
    assert emulator.zero


@pytest.mark.parametrize('age', [3.0, -1.0])
def test_silence_and_stale_stamps_end_in_zero(emulator: Any, ros: Any, age: float) -> None:
    graph = _start(emulator, ros)
    _driving(graph, emulator, command_timeout_s=2.0)

    def no_command_of_now() -> bool:
        _command(graph, 3e-3, 0.0, age=age)
        return bool(emulator.zero)
    graph.until(no_command_of_now)
    assert graph.nodes['coil_driver']._refused > 0
    complaint = graph.nodes['coil_driver']._complaint
    assert 'command ignored' in complaint
    assert ' is -' not in complaint


@pytest.mark.parametrize('leave', ['deactivate', 'shutdown', 'exception'])
def test_every_way_out_ends_in_zero(emulator: Any, ros: Any, leave: str) -> None:
    graph = _start(emulator, ros)
    driver = graph.nodes['coil_driver']
    _driving(graph, emulator)
    if leave == 'exception':
        def broken(_: Any) -> None:
            raise RuntimeError('broken on purpose')
        driver.stage.step = broken
        _command(graph, 3e-3, 0.0)
    else:
        getattr(driver, f'trigger_{leave}')()
    graph.until(lambda: emulator.zero)
    assert not driver._driver.gate.armed
    assert driver._driver.gate.fault is None


def test_the_line_may_go_and_come_back_but_stays_disarmed(
        emulator: Any, ros: Any, tmp_path: Any) -> None:
    graph = _start(emulator, ros)
    driver = graph.nodes['coil_driver']
    _driving(graph, emulator)
    armed = graph.hear(Bool, 'coil_driver/armed', LATCHED)
    graph.until(lambda: armed and armed[-1].data)
    emulator.end()
    graph.until(lambda: not armed[-1].data)  # though no reading comes
    assert driver.health()[0] == b'\x02'
    refusal = _arm(graph)
    assert (refusal.success, 'not connected' in refusal.message) == (False, True)
    with type(emulator)(tmp_path) as again:
        graph.until(lambda: driver._driver.connected)
        assert again.zero
        graph.until(lambda: _arm(graph).success)


def test_a_coil_that_is_reversed_cannot_be_armed_and_is_named(
        emulator: Any, ros: Any, tmp_path: Any) -> None:
    emulator.end()
    with type(emulator)(tmp_path, faults=['reversed=2']) as reversed_coil:
        graph = _start(reversed_coil, ros)
        health = graph.nodes['coil_driver'].health
        assert health()[2]['self_check'] == 'not passed yet'
        graph.until(lambda: 'self-check: coil_plus_x is reversed' in _arm(graph).message)
        level, sentence, values = health()
        assert level == b'\x02'
        assert sentence.startswith('disarmed, self-check: coil_plus_x is reversed')
        assert values['self_check'] == 'not passed yet'


def test_without_a_self_check_the_diagnostics_say_so(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros, self_check=False, accept_no_watchdog=True)
    graph.until(lambda: _arm(graph).success)
    assert not any(any(entry['currents_A']) for entry in emulator.entries())
    assert graph.nodes['coil_driver'].health()[2]['self_check'].startswith('not checked: ')


def _fault(graph: Any) -> str:
    found = graph.nodes['coil_driver']._driver.gate.fault
    return f'{found.reason.value}: {found.detail}' if found else ''


def test_the_permission_ends_when_nobody_commands(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros, idle_disarm_s=1.0)
    driver = graph.nodes['coil_driver']
    graph.until(lambda: _arm(graph).success)
    graph.until(lambda: not driver._driver.gate.armed)
    level, sentence, _ = driver.health()
    assert level == b'\x01'
    assert 'no command for' in sentence
    begin, heard = len(emulator.entries()), driver._driver.amplifier.counters.frames_received
    graph.until(lambda: _command(graph, 3e-3, 0.0) or (
        driver._driver.amplifier.counters.frames_received > heard + 10))
    assert len(emulator.entries()) == begin


def test_arming_is_for_somebody(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    graph.probe.destroy_publisher(graph.commands)
    driver = graph.nodes['coil_driver']
    graph.until(lambda: not driver._commanders()[0])
    answer = _arm(graph)
    assert (answer.success, answer.message) == (
        False, 'no node publishes field/command: start the controller first')


def test_a_second_commander_trips_and_both_are_named(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    _driving(graph, emulator)
    other = rclpy.create_node('intruder', namespace='/elsewhere')
    try:
        other.create_publisher(Vector3Stamped, '/field/command', 10)
        graph.until(lambda: emulator.zero and not graph.nodes['coil_driver']._driver.gate.armed)
        assert _fault(graph).startswith('second commander: 2 nodes publish commands: ')
        answer = _arm(graph)
        assert not answer.success
        assert '/elsewhere/intruder and /probe' in answer.message
    finally:
        other.destroy_node()
    graph.until(lambda: _arm(graph).success)


def test_two_processes_are_two_commanders_whatever_their_names_and_topics(
        emulator: Any, ros: Any, monkeypatch: Any) -> None:
    driver = _start(emulator, ros).nodes['coil_driver']

    def told(*found: tuple[str, str, int, int]) -> tuple[list[str], int]:
        def publishers(topic: str) -> list[SimpleNamespace]:
            return [SimpleNamespace(
                node_namespace='/', node_name=name,
                endpoint_gid=[process] * 12 + [0, 0, number, 3])
                for on, name, process, number in found if on == topic]
        monkeypatch.setattr(driver, 'get_publishers_info_by_topic', publishers)
        names, endpoints = driver._commanders()
        return names, len(endpoints)
    one, both = ('field/command', 'a', 1, 1), ('field/rotating', 'a', 1, 2)
    assert told(one) == (['/a'], 1)
    assert told(one, both) == (['/a'], 2)
    assert told(one, ('field/rotating', 'a', 2, 2)) == (['/a', '/a'], 2)
    assert told(one, ('field/command', 'a', 1, 2)) == (['/a', '/a'], 2)
    assert told(one, ('field/rotating', 'b', 1, 2)) == (['/a', '/b'], 2)


def test_who_commands_matters_only_while_armed_and_where_there_is_one(
        emulator: Any, ros: Any, monkeypatch: Any) -> None:
    graph, asked = _start(emulator, ros), []
    driver = graph.nodes['coil_driver']

    def look(*found: str) -> None:
        with monkeypatch.context() as patched:
            patched.setattr(driver, '_commanders', lambda: (list(found), {*found}))
            patched.setattr(driver._driver, 'request_zero', asked.append)
            driver._on_commanders(None)
    look('/one', '/other')
    graph.until(lambda: _arm(graph).success)
    look()
    assert asked == []


def test_who_commands_is_looked_at_again_once_armed(
        emulator: Any, ros: Any, monkeypatch: Any) -> None:
    """Another may have come while arming, whose arrival counted for nothing."""
    graph, armed = _start(emulator, ros), []
    driver = graph.nodes['coil_driver']
    monkeypatch.setattr(driver, '_on_commanders',
                        lambda _: armed.append(driver._driver.gate.armed))
    graph.until(lambda: _arm(graph).success)
    assert armed == [True]


def test_what_is_told_of_the_coils_is_what_the_driver_says(
        emulator: Any, ros: Any, monkeypatch: Any) -> None:
    node = _start(emulator, ros).nodes['coil_driver']
    gate = SimpleNamespace(fault=None, armed=False, holding=False, heat=(0.5, 0.25))
    amplifier = SimpleNamespace(unreachable=(), reads_back=True, counters=Counters())
    driver = SimpleNamespace(
        gate=gate, amplifier=amplifier, zero=Zero.SENT, zero_overdue=False, connected=True,
        arming=False, warning='', watchdog_s=0.1, gains=None, real_time='')
    with monkeypatch.context() as patched:
        patched.setattr(node, '_driver', driver)
        level, sentence, values = node.health()
        assert (level, sentence) == (b'\x00', 'disarmed; zero sent, not confirmed')
        assert values['hottest_coil_percent'] == 50.0
        assert values['watchdog'] == 'in the firmware, zeroed after 100 ms'
        driver.zero_overdue = True
        assert node.health()[0] == b'\x02'
        gate.armed = True
        assert node.health()[:2] == (b'\x00', 'driving')
        driver.warning = 'a watchdog is missing'
        assert node.health()[:2] == (b'\x00', 'driving; a watchdog is missing')
        assert f': {emulator.url}; ' in node._zero_sentence(Zero.UNREACHABLE)
        amplifier.unreachable = ('/dev/a', '/dev/b')
        assert ': /dev/a, /dev/b; ' in node._zero_sentence(Zero.UNREACHABLE)


@pytest.mark.parametrize(('zero', 'reads_back', 'success'), [
    (Zero.CONFIRMED, True, True), (Zero.SENT, True, False), (Zero.SENT, False, True),
    (Zero.UNREACHABLE, True, False), (Zero.UNREACHABLE, False, False)])
def test_disarming_succeeds_where_the_zero_is_as_sure_as_it_can_be(
        emulator: Any, ros: Any, monkeypatch: Any, zero: Zero, reads_back: bool, success: bool,
) -> None:
    node = _start(emulator, ros).nodes['coil_driver']
    with monkeypatch.context() as patched:
        patched.setattr(node._driver, 'await_zero', lambda _: zero)
        patched.setattr(node._driver.amplifier, 'reads_back', reads_back)
        answer = node._on_arm(SetBool.Request(data=False), SetBool.Response(), None)
    assert (answer.success, answer.message.startswith(zero)) == (success, True)


def test_a_node_that_is_not_active_cannot_be_armed(emulator: Any, ros: Any) -> None:
    node = _start(emulator, ros).nodes['coil_driver']
    node.trigger_deactivate()
    answer = node._on_arm(SetBool.Request(data=True), SetBool.Response(), node._driver.epoch)
    assert (answer.success, answer.message) == (False, 'the node is not active')


def test_every_parameter_of_the_driver_is_fixed_at_start_up() -> None:
    assert all(about(CoilDriverParameters, one.name).read_only
               for one in fields(CoilDriverParameters))
    assert about(CoilDriverParameters, 'full_scale_A').lower == 0.01


def test_a_commander_that_is_back_needs_a_new_arm(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    graph.until(lambda: _arm(graph).success)  # at rest: nothing goes stale
    driver = graph.nodes['coil_driver']
    graph.probe.destroy_publisher(graph.commands)
    graph.until(lambda: not driver._commanders()[0])
    assert driver._driver.gate.armed
    begin = len(emulator.entries())
    graph.commands = graph.probe.create_publisher(Vector3Stamped, 'field/command', 10)
    graph.until(lambda: _command(graph, 3e-3, 0.0) or not driver._driver.gate.armed)
    assert len(emulator.entries()) == begin
    assert _fault(graph) == ('second commander: /probe is new or was restarted; arm again')
    _driving(graph, emulator)


def test_a_command_in_another_frame_is_none(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    graph.until(lambda: _arm(graph).success)
    driver = graph.nodes['coil_driver']
    begin = len(emulator.entries())

    def refused() -> bool:
        stamp = messages.to_stamp(driver.seconds())
        message = messages.field_vector(np.array([3e-3, 0.0]), stamp)
        message.header.frame_id = 'camera'
        graph.commands.publish(message)
        return "expected the frame 'workspace'" in driver._complaint
    graph.until(refused)
    assert len(emulator.entries()) == begin


def test_a_board_without_a_watchdog_is_driven_where_it_is_accepted_by_name(
        emulator: Any, ros: Any, tmp_path: Any) -> None:
    emulator.end()
    with type(emulator)(tmp_path, watchdog_s=None) as unwatched:
        graph = _start(unwatched, ros, accept_no_watchdog=True)
        graph.until(lambda: _arm(graph).success)
        assert 'loses its power' in graph.nodes['coil_driver'].health()[2]['watchdog']
        assert 'loses its power' in _arm(graph).message
        _driving(graph, unwatched)
        assert 'loses its power' in graph.nodes['coil_driver'].health()[1]


def test_a_fault_names_the_parameters_of_its_limit(emulator: Any, ros: Any) -> None:
    driver = _start(emulator, ros).nodes['coil_driver']
    known = set(type(driver).known_parameters())
    for reason, limits in LIMITS.items():
        assert set(limits.split(', ')) <= known
        driver._driver.gate.fault = Fault(reason, 'why')
        assert driver.health()[1].startswith(f'disarmed, {reason.value} ({limits}): why; ')


def test_disarming_answers_what_is_known_of_the_currents(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    _driving(graph, emulator)
    answer = _arm(graph, on=False)
    assert (answer.success, answer.message) == (True, 'zero, confirmed by a reading')
    assert emulator.zero
    health = graph.nodes['coil_driver'].health
    assert health()[1] == 'disarmed; zero, confirmed by a reading'
    assert health()[2]['zero'] == 'zero, confirmed by a reading'
    emulator.end()
    graph.until(lambda: not graph.nodes['coil_driver']._driver.connected)
    answer = _arm(graph, on=False)
    assert not answer.success
    assert answer.message == (f'not reachable: {emulator.url}; these coils may carry current, '
                              'switch the amplifier off by hand')
    assert health()[0] == b'\x02'
    assert answer.message in health()[1]


def test_a_stop_does_not_wait_for_arming_and_what_arming_waits_for_is_refused(
        emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    graph.probe.destroy_publisher(graph.commands)
    driver = graph.nodes['coil_driver']
    graph.until(lambda: not driver._commanders()[0])
    client = graph.probe.create_client(SetBool, 'coil_driver/arm')
    graph.until(client.service_is_ready)
    arming = client.call_async(SetBool.Request(data=True))  # waits for somebody who commands
    epoch = driver._driver.epoch
    stopping = client.call_async(SetBool.Request(data=False))
    graph.until(lambda: driver._driver.epoch > epoch)
    graph.commands = graph.probe.create_publisher(Vector3Stamped, 'field/command', 10)
    graph.until(lambda: arming.done() and stopping.done())
    assert (arming.result().success, arming.result().message) == (False, STOPPED)
    assert stopping.result().success
    assert not driver._driver.gate.armed


def test_arming_that_was_sent_before_a_stop_is_refused_whenever_it_comes(
        emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    driver = graph.nodes['coil_driver']
    sent_ns = time.time_ns()
    assert _arm(graph, on=False).success
    late = SimpleNamespace(source_timestamp=sent_ns)
    epoch = driver._on_arm_asked(SetBool.Request(data=True), late)
    answer = driver._on_arm(SetBool.Request(data=True), SetBool.Response(), epoch)
    assert (answer.success, answer.message) == (False, STOPPED)
    graph.until(lambda: _arm(graph).success)


def test_what_was_commanded_before_arming_moves_nothing(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    request = SetBool.Request(data=True)
    graph.until(lambda: _command(graph, 3e-3, 0.0) or graph.call(
        SetBool, 'coil_driver/arm', request).success)
    driver, begin = graph.nodes['coil_driver'], len(emulator.entries())
    received = driver._driver.amplifier.counters
    heard = received.frames_received
    graph.until(lambda: _command(graph, 3e-3, 0.0) or received.frames_received > heard + 10)
    assert len(emulator.entries()) == begin
    assert driver.health()[:2] == (b'\x01', (
        'armed; waiting for a zero command: centre the stick, or stop the sender and send the '
        'goal again'))
    graph.until(lambda: _command(graph, 0.0, 0.0) or not driver._driver.gate.holding)
    graph.until(lambda: _command(graph, 3e-3, 0.0) or not emulator.zero)


def test_an_operator_whose_heartbeats_end_disarms(
        emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    beats = graph.probe.create_publisher(Empty, 'coil_driver/heartbeat', 10)
    _driving(graph, emulator)
    driver = graph.nodes['coil_driver']
    graph.until(lambda: beats.publish(Empty()) or driver._driver.gate._attended_s > 0)
    graph.until(lambda: not driver._driver.gate.armed)
    graph.until(lambda: emulator.zero)
    assert _fault(graph).startswith('operator heartbeat lost: no operator heartbeat')


def test_a_hot_coil_is_hot_after_a_restart(emulator: Any, ros: Any) -> None:
    graph = _start(emulator, ros)
    driver = graph.nodes['coil_driver']
    driver._driver.gate.heat = (0.5, 0.2, 0.0, 0.0)
    graph.until(driver._heat.path.exists)  # for one that is killed
    driver._driver.gate.heat = (0.9, 0.2, 0.0, 0.0)
    assert driver.health()[2]['hottest_coil_percent'] == pytest.approx(90.0, abs=1.0)
    driver.trigger_deactivate()
    driver.trigger_cleanup()
    driver.trigger_configure()
    assert driver._driver.gate.heat[0] > 0.85
    driver._heat.path.unlink()


def test_a_lost_amplifier_is_an_error_that_names_its_port(emulator: Any, ros: Any) -> None:
    """Where it was disarmed as nobody commanded, which is no fault."""
    graph = _start(emulator, ros, idle_disarm_s=1.0)
    driver = graph.nodes['coil_driver']
    graph.until(lambda: _arm(graph).success)
    graph.until(lambda: not driver._driver.gate.armed)
    emulator.end()
    graph.until(lambda: not driver._driver.connected)
    level, sentence, _ = driver.health()
    assert level == b'\x02'
    assert sentence.startswith(f'amplifier lost at {emulator.url}, reconnecting; ')


def test_a_zero_that_nothing_can_confirm_is_told_with_its_reason(emulator: Any, ros: Any) -> None:
    driver = _start(emulator, ros).nodes['coil_driver']
    assert driver._zero_sentence(Zero.SENT) == Zero.SENT
    driver._driver.amplifier.reads_back = False
    told = driver._zero_sentence(Zero.SENT)
    assert told == f'{Zero.SENT}: the amplifier measures no currents'
    assert driver._zero_sentence(Zero.CONFIRMED) == Zero.CONFIRMED


def test_a_disk_that_is_full_is_told(emulator: Any, ros: Any, monkeypatch: Any) -> None:
    def full(_: Any) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    driver, told = _start(emulator, ros).nodes['coil_driver'], []
    monkeypatch.setattr(driver, 'complain', told.append)
    monkeypatch.setattr(driver._heat, 'save', full)
    driver._driver.gate.heat = (0.9, 0.2, 0.0, 0.0)
    driver._save_heat()
    assert told[-1].endswith('cannot be saved for a restart (No space left on device)')


@pytest.mark.parametrize('lost', [False, True])
def test_the_end_says_where_no_zero_is_confirmed(
        emulator: Any, ros: Any, monkeypatch: Any, lost: bool) -> None:
    driver, warned = _start(emulator, ros).nodes['coil_driver'], []
    if lost:
        emulator.end()
    with monkeypatch.context() as patched:
        patched.setattr(driver, 'get_logger', lambda: SimpleNamespace(
            warning=lambda sentence, **_: warned.append(sentence)))
        driver.teardown()
    said = [sentence for sentence in warned if sentence.startswith('coils at shutdown')]
    assert ['not reachable' in sentence for sentence in said] == [True] * lost


@pytest.mark.parametrize(('parameters', 'expected'), [
    ({}, 'expected the parameter port'),
    ({'port': 'x', 'deviation_A': 1.0}, 'self-check'),
    ({'port': '/nowhere/tty'}, '/nowhere/tty'),
    ({'port': 'x', 'current_limit_A': 1.0}, 'current_limit_A: expected at least 1.166 A, which a '
     'field of 5 mT needs with these coils; received 1 A'),
    ({'port': 'x', 'step_limit_A': 2.0}, 'step_limit_A: expected at least 2.332 A'),
    ({'port': 'x', 'amplifier': 'modbus'},
     'accept_no_watchdog: the amplifier has no reliable watchdog'),
    ({'port': 'x,y', 'amplifier': 'sabertooth', 'self_check': False},
     'accept_no_feedback: the amplifier measures no currents'),
    ({'port': 'x', 'amplifier': 'steam'}, "received 'steam'"),
    ({'port': 'x,y', 'amplifier': 'roboteq', 'board_turns': True},
     'board_turns: roboteq cannot rotate the field itself'),
    ({'port': 'x', 'coils_file': '/nowhere/coils.yaml'}, '/nowhere/coils.yaml'),
])
def test_what_cannot_be_opened_is_one_clear_line(
        ros: Any, parameters: dict[str, Any], expected: str) -> None:
    node = ros({'coil_driver': parameters}).add('coil_driver')
    assert not node.active
    assert expected in node.fault
    assert '\n' not in node.fault
