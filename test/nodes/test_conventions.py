"""What any ROS node does: every transition of the lifecycle, simulated time, remapping."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rig_file import write_rig
from rosgraph_msgs.msg import Clock
from schemas import schema_file
from session.recordings import record, small_session

from bench._emulator import Served
from microbot_ros.nodes.base.messages import stamp_at
from microbot_ros.nodes.base.names import NODES
from microbot_ros.nodes.base.topics import TOPICS, type_name
from microbot_ros.nodes.process import make

_STEPS = [
    (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
    (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
    (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
    (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE)]
_SHUTDOWNS = {
    (): Transition.TRANSITION_ACTIVE_SHUTDOWN,
    (Transition.TRANSITION_DEACTIVATE,): Transition.TRANSITION_INACTIVE_SHUTDOWN,
    (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        Transition.TRANSITION_UNCONFIGURED_SHUTDOWN}


@pytest.fixture
def start(ros: Any, tmp_path: Path) -> Any:
    """Starts a node by its name, with all that it needs to be active."""
    ends: list[Callable[[], None]] = []

    def begin(name: str, **more: Any) -> Any:
        amplifier = Served(tmp_path)
        ends.append(amplifier.end)
        frames = tmp_path / 'frames'
        frames.mkdir()
        cv2.imwrite(str(frames / '0.png'), np.full((480, 640), 128, np.uint8))
        session = record(tmp_path / 'session', small_session())
        own: dict[str, dict[str, Any]] = {
            'camera': {'source': str(frames)},
            'cockpit': {'port': 0, 'token': False},
            'coil_driver': {'port': amplifier.url},
            'player': {'session': str(session)},
            'recorder': {'folder': str(tmp_path / 'out'), 'recording': False},
            'tracker': {'pixel_size_um': 0.45},
            'virtual_rig': {'amplifier_log': str(amplifier.log)}}
        graph = ros({name: {**own.get(name, {}), **more}})
        assert graph.add(name).active, graph.nodes[name].fault
        return graph

    yield begin
    for end in ends:
        end()


def _change(graph: Any, name: str, transition: int) -> int:
    """The state after a `transition` that `ros2 lifecycle set` would ask for."""
    assert graph.call(ChangeState, f'{name}/change_state', ChangeState.Request(
        transition=Transition(id=transition))).success
    state: int = graph.call(GetState, f'{name}/get_state', GetState.Request()).current_state.id
    return state


@pytest.mark.parametrize('name', NODES)
def test_every_transition_leads_there_and_back(start: Any, name: str) -> None:
    graph = start(name)
    for transition, state in _STEPS:
        assert _change(graph, name, transition) == state
    assert graph.nodes[name].active
    assert not graph.nodes[name].fault


@pytest.mark.parametrize('before', _SHUTDOWNS)
@pytest.mark.parametrize('name', NODES)
def test_every_state_can_be_shut_down(start: Any, name: str, before: tuple[int, ...]) -> None:
    graph = start(name)
    for transition in before:
        _change(graph, name, transition)
    assert _change(graph, name, _SHUTDOWNS[before]) == State.PRIMARY_STATE_FINALIZED


@pytest.mark.parametrize('name', ['tracker', 'model', 'controller', 'recorder'])
def test_simulated_time_is_that_of_the_clock(start: Any, name: str) -> None:
    graph = start(name, use_sim_time=True)
    clock = graph.probe.create_publisher(Clock, '/clock', 10)
    node = graph.nodes[name]

    def told() -> bool:
        clock.publish(Clock(clock=stamp_at(1_234_500_000_000)))
        return bool(node.get_clock().now().nanoseconds == 1_234_500_000_000)
    graph.until(told)


def test_topics_are_remapped(ros: Any) -> None:
    ros({})
    node = make('tracker', ['--ros-args', '-p', 'pixel_size_um:=0.45', '-r', 'particles:=seen',
                            '-r', 'camera/image_raw:=left/image_raw'])
    try:
        node.trigger_configure()
        assert node.count_publishers('/seen') == 1
        assert node.count_publishers('/particles') == 0
        assert node.count_subscribers('/left/image_raw') == 1
    finally:
        node.make_safe_and_close()
        node.destroy_node()


@pytest.mark.parametrize('name', NODES)
def test_strings_have_a_schema_and_services_standard_types(start: Any, name: str) -> None:
    """Of all that a node really publishes and offers: JSON only by a published schema, and only
    services that switch or trigger."""
    node = start(name).nodes[name]
    topics = node.get_publisher_names_and_types_by_node(name, '/')
    for topic in [topic for topic, kinds in topics if kinds == ['std_msgs/msg/String']]:
        assert schema_file(topic.strip('/'))
    own = {kind for _, kinds in node.get_service_names_and_types_by_node(name, '/')
           for kind in kinds if not kind.startswith((
               'rcl_interfaces/', 'lifecycle_msgs/', 'type_description_interfaces/'))}
    assert own <= {'std_srvs/srv/SetBool', 'std_srvs/srv/Trigger'}


def test_parameter_files_compose(ros: Any, tmp_path: Path) -> None:
    """The later file wins, the command line over both, and a wildcard is of any namespace."""
    ros({})
    first = write_rig(tmp_path / 'first.yaml', {
        '/**/tracker': {'pixel_size_um': 0.45, 'rotation_deg': 11.0, 'poses_rate_hz': 4.0}})
    second = write_rig(tmp_path / 'second.yaml', {
        '/rig_2/tracker': {'rotation_deg': 12.0, 'poses_rate_hz': 5.0},
        '/rig_3/tracker': {'rotation_deg': 13.0}})
    node = make('tracker', ['--ros-args', '-r', '__ns:=/rig_2', '--params-file', str(first),
                            '--params-file', str(second), '-p', 'poses_rate_hz:=6.0'])
    try:
        now = node.settings
        assert (now.pixel_size_um, now.rotation_deg, now.poses_rate_hz) == (0.45, 12.0, 6.0)
    finally:
        node.make_safe_and_close()
        node.destroy_node()


def test_recorded_definitions_are_those_of_the_distribution(ros: Any) -> None:
    """Of each type that is recorded, by the hash that the middleware announces (REP 2016)."""
    from microbot_ros.session.mcap.bag import typestore

    probe = ros({}).probe
    for kind in {kind for kind, _ in TOPICS.values()}:
        name = type_name(kind)
        publisher = probe.create_publisher(kind, 'hashed', 1)
        info, = probe.get_publishers_info_by_topic('/hashed')
        assert str(info.topic_type_hash) == typestore().hash_rihs01(name), name
        probe.destroy_publisher(publisher)


_IMPORT = """
import resource, sys
import rclpy.experimental.events_executor, rclpy.lifecycle
import diagnostic_msgs.msg, geometry_msgs.msg, lifecycle_msgs.msg, lifecycle_msgs.srv, nav_msgs.msg
import rcl_interfaces.msg, rcl_interfaces.srv, rosgraph_msgs.msg, sensor_msgs.msg, std_msgs.msg
import std_srvs.srv, trajectory_msgs.msg, visualization_msgs.msg
before = resource.getrusage(resource.RUSAGE_SELF)
import microbot_ros.nodes.process, microbot_ros.nodes.{name}
after = resource.getrusage(resource.RUSAGE_SELF)
print(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
print(*{{'numba', 'scipy', 'microbot_ros.tracking.tracker'}} & set(sys.modules))
"""


def _imported(name: str) -> tuple[float, set[str]]:
    """Processor time [s] to import a node after ROS, and what heavy modules that imports."""
    done = subprocess.run([sys.executable, '-c', _IMPORT.format(name=name)],
                          capture_output=True, text=True, check=True)
    seconds, heavy = done.stdout.splitlines()
    return float(seconds), set(heavy.split())


@pytest.mark.parametrize('name', NODES)
def test_nodes_import_no_compiler(name: str) -> None:
    """Numba and SciPy take 0.5 s of the processor; they are loaded when a node is configured."""
    _, heavy = _imported(name)
    assert heavy <= ({'microbot_ros.tracking.tracker'} if name == 'tracker' else set())


@pytest.mark.rig
@pytest.mark.parametrize('name', NODES)
def test_nodes_are_imported_in_0_4_s(name: str) -> None:
    """Of the processor, beyond rclpy and messages: the least of five."""
    assert min(_imported(name)[0] for _ in range(5)) <= 0.4


_CONFIGURE = """
import sys
import rclpy
from microbot_ros.common import compiled
from microbot_ros.nodes.process import make
rclpy.init()
node = make('{name}', ['--ros-args', *{parameters}])
node.trigger_configure()
assert not node.fault, node.fault
assert 'numba' in sys.modules and not compiled._new
node.make_safe_and_close()
"""


@pytest.mark.parametrize(('name', 'parameters'), [
    ('controller', []), ('model', []), ('tracker', ['-p', 'pixel_size_um:=0.45'])])
def test_no_frame_waits_for_the_compiler(name: str, parameters: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, '-c', _CONFIGURE.format(name=name, parameters=parameters)],
        capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
