"""What runs a node in a process: started, and ended with the coils at zero."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import rclpy.executors
from geometry_msgs.msg import Vector3Stamped
from in_process import PATIENT, command, own_context, run_queue
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future
from rig_file import write_rig
from std_srvs.srv import SetBool

from microbot_ros.nodes import process
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.graph import READY


@pytest.fixture(autouse=True)
def _ordinary(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave the priorities and the heap of the tests' process alone."""
    for name in ('set_realtime_priority_of_all', 'leave'):
        monkeypatch.setattr(process, name, lambda *_: None)
    for name in ('gc.freeze', 'sys.setswitchinterval'):
        monkeypatch.setattr(f'microbot_ros.nodes.process.{name}', lambda *_: None)
    with own_context():
        yield


def _arguments(folder: Path, nodes: dict[str, dict[str, Any]]) -> list[str]:
    file = write_rig(folder / 'nodes.yaml', {
        name: PATIENT.get(name, {}) | values for name, values in nodes.items()})
    return ['--ros-args', '--params-file', str(file)]


def _once_settled(monkeypatch: pytest.MonkeyPatch, do: Callable[[], None]) -> threading.Thread:
    """Do something in a thread once the nodes run, and then end them by a signal."""
    def act() -> None:
        try:
            do()
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
    thread = threading.Thread(target=act, daemon=True)
    settle = process._settle

    def settled(*what: Any) -> None:
        settle(*what)
        thread.start()
    monkeypatch.setattr(process, '_settle', settled)
    return thread


def test_a_driver_is_ended_by_a_signal_at_zero(
        tmp_path: Path, emulator: Any, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    arguments = _arguments(tmp_path, {'coil_driver': {'port': emulator.url}})
    flowed: list[bool] = []

    def drive() -> None:
        rclpy.init(context=(context := rclpy.Context()))
        node = rclpy.create_node('commander', context=context)
        try:
            field = node.create_publisher(Vector3Stamped, 'field/command', 10)
            arm = node.create_client(SetBool, 'coil_driver/arm')
            assert arm.wait_for_service(60.0)
            deadline, asked, asked_s = time.monotonic() + 60.0, Future(), -math.inf
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(node)
            while not any(any(entry['currents_A']) for entry in emulator.entries()[-5:]) or (
                    not asked.done()):
                now = time.monotonic()
                assert now < deadline
                if now - asked_s > 5.0:  # an answer may be lost, and what is armed may lapse
                    asked, asked_s = arm.call_async(SetBool.Request(data=True)), now
                strength = 1e-3 if asked.done() else 0.0
                field.publish(messages.field_vector(
                    np.array([strength, 0.0]), node.get_clock().now().to_msg()))
                executor.spin_once(timeout_sec=0.01)
            flowed.append(asked.result().success)
        finally:
            node.destroy_node()
            context.try_shutdown()
    thread = _once_settled(monkeypatch, drive)
    assert process.run('coil_driver', arguments) == 0
    thread.join()
    assert f'{READY} coil_driver' in capfd.readouterr().out
    assert flowed == [True]
    assert emulator.zero


def test_a_publisher_that_came_to_a_subscription_now_destroyed_is_no_fault() -> None:
    rclpy.init(context=(context := rclpy.Context()))
    node = rclpy.create_node('hearing', context=context)
    try:
        executor = EventsExecutor(context=context)
        executor.add_node(node)
        heard = node.create_subscription(
            Vector3Stamped, 'field', lambda _: None, 1,
            event_callbacks=SubscriptionEventCallbacks(matched=lambda _: None))
        run_queue(executor)  # now it knows the subscription
        node.create_publisher(Vector3Stamped, 'field', 1)
        while not heard.get_publisher_count():
            time.sleep(0.01)
        node.destroy_subscription(heard)
        run_queue(executor)
        executor.shutdown()
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_a_node_that_cannot_begin_is_one_line_and_two(
        tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = _arguments(tmp_path, {'camera': {'source': '/nowhere/film.mp4'}})
    assert process.run('camera', arguments) == 2
    said = [line for line in capfd.readouterr().err.splitlines() if 'microbot: ' in line]
    assert len(said) == 1
    assert '/nowhere/film.mp4' in said[0]


def test_a_node_that_would_ignore_its_file_does_not_start(
        tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = _arguments(tmp_path, {'coil_driver': {'current_limit_A': 0.1}})
    assert process.run('coil_driver', [*arguments, '-r', '__ns:=/rig_2']) == 2
    assert '/**/coil_driver' in capfd.readouterr().err


@pytest.mark.parametrize('words', [[], ['steam']])
def test_what_is_no_node_is_two(
        words: list[str], monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr('sys.argv', ['nodes', *words])
    with pytest.raises(SystemExit) as ended:
        process.main()
    assert ended.value.code == 2
    assert 'coil_driver' in capfd.readouterr().err


def test_a_page_that_cannot_be_served_is_one_line() -> None:
    pytest.importorskip('uvicorn', reason='the extra `cockpit` is not installed')
    for host in ('NONSENSE', 'x' * 9000):
        status, out, error = command('cockpit', '--host', host)
        line, = (one for one in error.splitlines() if one.startswith('microbot: '))
        assert line.startswith('microbot: cockpit: host: expected a host name or address')
        assert 'x' * 81 not in line
        assert (status, out) == (2, '')
