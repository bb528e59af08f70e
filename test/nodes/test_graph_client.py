"""What is said to a running rig is taken, or the command says that it was not: real processes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Vector3Stamped
from rclpy.service import Service
from sensor_msgs.msg import PointCloud2

from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.loop.points import ESTIMATE
from microbot_ros.nodes import messages
from microbot_ros.nodes.graph import Graph
from microbot_ros.nodes.graph_client import GraphClient

pytestmark = [pytest.mark.graph, pytest.mark.timeout(240)]

Answer = tuple[int, str, str]
"""Exit status, standard output, standard error."""


def _start(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, '-m', 'microbot_ros.cli', *words],
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _end(process: subprocess.Popen[str]) -> Answer:
    out, error = process.communicate(timeout=60)
    return process.returncode, out, error


def _microbot(*words: str) -> Answer:
    return _end(_start(*words))


def _parameters(folder: Path, nodes: dict[str, dict[str, Any]]) -> Path:
    file = folder / 'rig.yaml'
    file.write_text(yaml.safe_dump({
        f'/**/{node}': {'ros__parameters': values} for node, values in nodes.items()}))
    return file


def test_goals_are_taken_each_time_beside_a_recorder_that_was_there_first(
        tmp_path: Path) -> None:
    parameters = _parameters(tmp_path, {
        'recorder': {'folder': str(tmp_path / 'recording')},
        'controller': {'controller': 'waypoint'}})
    heard: list[dict[str, str]] = []
    with Graph(lambda *_: None) as graph, GraphClient('test') as client:
        for node in ('recorder', 'controller'):
            graph.start_nodes([node], parameters)
            graph.wait_ready(60.0)
        client.watch_progress(lambda _level, _sentence, values: heard.append(values))
        assert client.until(lambda: heard, 10)

        def has(goals: int, path: bool) -> bool:
            """Whether the controller holds so many goals, and a path of its own."""
            last = heard[-1]
            return int(last['goals']) == goals and (float(last['path_stamp_s']) > 0) == path
        for count in range(1, 11):
            status, out, error = _microbot('goal', *['10,10'] * count)
            assert (status, error) == (0, '')
            assert out == f"{count} goal{'s' * (count > 1)} taken by controller 'waypoint'\n"
            # It is there when the command ends, and not some time later.
            heard.clear()
            assert client.until(lambda: heard, 10)
            assert client.until(lambda count=count: has(count, False), 1.0)
        client.set('controller', controller='path_following')
        assert _microbot('goal', '--path', '0,0', '10,0') == (
            0, "path of 2 points taken by controller 'path_following'\n", '')
        assert client.until(lambda: has(10, True), 1.0)
        for words, what, who in ((('1,1',), 'goals', 'waypoint'),
                                 (('--path', '0,0', '9,9'), 'path', 'path_following')):
            client.set('controller', controller='manual')
            status, out, error = _microbot('goal', *words)
            assert (status, out) == (1, '')
            assert error.startswith(f'microbot: controller: manual takes no {what}; these do: ')
            assert who in error
            assert has(10, True)
        assert _microbot('goal', '--cancel') == (0, 'cancelled\n', '')
        assert client.until(lambda: has(0, True), 1.0)


@pytest.mark.parametrize(('controller', 'words'), [
    ('waypoint', ('1000,0',)), ('path_following', ('--path', '0,0', '1000,0'))])
def test_goals_outside_the_workspace_are_one_and_the_reason(
        tmp_path: Path, controller: str, words: tuple[str, ...]) -> None:
    parameters = _parameters(tmp_path, {'controller': {'controller': controller}})
    particle = np.zeros(1, ESTIMATE)
    for name in ('speed', 'x_std', 'y_std', 'speed_std', 'phi_std'):
        particle[name] = 4e-6 if name == 'speed' else 1e-8
    with Graph(lambda *_: None) as graph, GraphClient('test') as client:
        graph.start_nodes(['controller'], parameters)
        graph.wait_ready(60.0)
        seen = client.node.create_publisher(PointCloud2, 'model/state', 10)
        client.node.create_timer(0.05, lambda: seen.publish(
            messages.cloud(particle, client.node.get_clock().now().to_msg())))
        asked = _start('goal', *words)
        client.until(lambda: asked.poll() is not None, 60)
        status, out, error = _end(asked)
    assert (status, out) == (1, '')
    assert error.startswith(f'microbot: {controller}: ')
    assert 'workspace' in error
    assert len(error.splitlines()) == 1


def test_a_node_that_is_not_there_is_one_and_the_reason() -> None:
    asked = {('goal', '1,1'): 'controller', ('arm',): 'coil_driver', ('record',): 'recorder',
             ('set', 'controller', 'controller', 'hold'): 'controller'}
    commands = {words: _start(*words) for words in asked}
    for words, node in asked.items():
        assert _end(commands[words]) == (
            1, '', f'microbot: {node} was not found in the namespace / within 5 s: is it '
            'running?\n')


def test_what_is_no_name_is_two() -> None:
    assert _microbot('arm', '--namespace', 'rig 2') == (
        2, '', 'microbot: --namespace: expected a name such as rig_2; received /rig 2\n')
    assert _microbot('set', 'no node', 'a', '1') == (
        2, '', "microbot: expected the name of a node; received 'no node'\n")


def test_each_command_speaks_to_the_rig_of_its_namespace(tmp_path: Path, emulator: Any) -> None:
    parameters = _parameters(tmp_path, {
        'recorder': {'recording': False},
        'coil_driver': {'port': str(emulator.port), 'full_scale_A': 2.0}})
    nodes = ['controller', 'recorder', 'coil_driver']
    with Graph(lambda *_: None) as graph:
        graph.start('rig', [sys.executable, '-m', 'microbot_ros.nodes', *nodes, '--ros-args',
                            '-r', '__ns:=/rig_2', '--params-file', str(parameters)])
        graph.wait_ready(60.0)
        there, folder = ('--namespace', 'rig_2'), str(tmp_path / 'run')
        assert _microbot('set', 'controller', 'controller', 'waypoint', *there)[0] == 0
        assert _microbot('goal', '1,1', *there) == (
            0, "1 goal taken by controller 'waypoint'\n",
            'coil_driver: disarmed; zero, confirmed by a reading\n')
        assert _microbot('record', '--folder', folder, *there) == (
            0, f'recording to {folder}\n', '')
        assert _microbot('arm', *there) == (0, 'armed\n', '')
        assert _microbot('goal', '1,1', *there) == (
            0, "1 goal taken by controller 'waypoint'\n", '')
        elsewhere = [_start('goal', '1,1'), _start('arm', '--off'), _start('record', '--stop')]
        for command, node in zip(elsewhere, nodes[:1] + nodes[:0:-1], strict=True):
            assert _end(command) == (
                1, '', f'microbot: {node} was not found in the namespace / within 5 s: is it '
                'running? There is one in --namespace /rig_2\n')


@pytest.fixture
def lose(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[str]]:
    """Makes the first answer of a service go astray, as one does whose way is not known yet."""
    deliver, lost = Service.send_response, []

    def lose_first(name: str) -> list[str]:
        def send(service: Service, *answer: Any) -> None:
            if service.srv_name == name and name not in lost:
                lost.append(name)
            else:
                deliver(service, *answer)
        monkeypatch.setattr(Service, 'send_response', send)
        return lost
    return lose_first


def _command(graph: Any, *words: str) -> Answer:
    """A command beside nodes of this process, which must be served meanwhile."""
    process = _start(*words)
    graph.until(lambda: process.poll() is not None, 60)
    return _end(process)


def test_a_controller_that_does_not_answer_is_one_and_the_reason(ros: Any) -> None:
    graph = ros({'controller': {'controller': 'waypoint'}})
    graph.add('controller').trigger_deactivate()
    assert _command(graph, 'goal', '1,1', '--wait', '60') == (
        1, '', 'microbot: controller did not take the goals within 5 s: it says nothing; is it '
        'active?\n')
    assert len(graph.nodes['controller'].stage.goals) == 0


def test_a_recorder_whose_answer_was_lost_has_done_it(
        ros: Any, tmp_path: Path, lose: Callable[[str], list[str]]) -> None:
    graph = ros({'recorder': {'recording': False}})
    recorder = graph.add('recorder')
    run, twice = str(tmp_path / 'run'), ('record', '--folder', str(tmp_path / 'other'))
    lost = lose('~/record')
    assert _command(graph, 'record', '--folder', run) == (0, f'recording to {run}\n', '')
    assert lost
    assert recorder.health()[1] == f'recording to {run}'
    # Without a loss the same words are a refusal.
    assert _command(graph, *twice) == (
        1, '', f'microbot: recorder: already recording to {run}\n')
    lost.clear()
    assert _command(graph, 'record', '--stop') == (0, 'the recording has ended\n', '')
    assert lost
    assert recorder.health()[1] == 'not recording'
    assert _command(graph, 'record', '--stop') == (1, '', 'microbot: recorder: not recording\n')


def _driver_and_commander(ros: Any, emulator: Any) -> tuple[Any, Any]:
    graph = ros({'coil_driver': {'port': str(emulator.port), 'full_scale_A': 2.0}})
    graph.probe.create_publisher(Vector3Stamped, 'field/command', 1)
    driver = graph.add('coil_driver')
    graph.until(lambda: len(driver._commanders()) == 1)
    return graph, driver


def _requests(driver: Any) -> list[bool]:
    """What the driver is asked from now on: True to arm, False for a zero."""
    asked: list[bool] = []
    arm, zero = driver._driver.arm, driver._driver.request_zero
    driver._driver.arm = lambda epoch: asked.append(True) or arm(epoch)
    driver._driver.request_zero = lambda *why: asked.append(False) or zero(*why)
    return asked


@pytest.mark.rig
def test_arming_whose_answer_was_lost_is_not_asked_for_again(
        ros: Any, emulator: Any, lose: Callable[[str], list[str]]) -> None:
    lost = lose('~/arm')
    graph, driver = _driver_and_commander(ros, emulator)
    asked = _requests(driver)
    assert _command(graph, 'arm') == (
        1, '', 'microbot: coil_driver did not answer within 12 s; disarmed: '
        'zero, confirmed by a reading\n')
    assert lost
    assert asked == [True, False]
    assert not driver.health()[2]['armed']


@pytest.mark.rig
def test_disarming_tells_what_the_driver_answered(
        ros: Any, emulator: Any, lose: Callable[[str], list[str]],
        monkeypatch: pytest.MonkeyPatch) -> None:
    lost = lose('~/arm')
    lost.append('~/arm')  # not yet
    graph, driver = _driver_and_commander(ros, emulator)
    assert _command(graph, 'arm') == (0, 'armed\n', '')
    lost.clear()  # a request to disarm is repeated
    assert _command(graph, 'arm', '--off') == (
        0, 'disarmed: zero, confirmed by a reading\n', '')
    for zero, words in ((Zero.SENT, 'zero sent, not confirmed'),
                        (Zero.UNREACHABLE, 'not reachable: ')):
        with monkeypatch.context() as patch:
            patch.setattr(CoilDriver, 'zero', zero)
            status, out, error = _command(graph, 'arm', '--off')
        assert (status, out) == (1, '')
        assert error.startswith(f'microbot: coil_driver: {words}')
        assert len(error.splitlines()) == 1
    emulator.end()
    graph.until(lambda: driver.health()[0] == b'\x02')
    assert _command(graph, 'arm') == (
        1, '', 'microbot: coil_driver: the amplifier is not connected\n')


@pytest.mark.filterwarnings('ignore:failed to send response:RuntimeWarning')
def test_arming_that_was_given_up_does_not_come_true_later(ros: Any, emulator: Any) -> None:
    """A driver that hangs while it is asked finds the requests when it goes on."""
    graph, driver = _driver_and_commander(ros, emulator)
    asked = _requests(driver)
    assert _microbot('arm') == (
        1, '', 'microbot: coil_driver did not answer within 12 s; asked to disarm: coil_driver '
        'did not answer within 12 s: not reachable, switch the amplifier off by hand\n')
    graph.until(lambda: False in asked)
    graph.until(lambda: driver._driver.zero is Zero.CONFIRMED)
    assert asked.count(True) <= 1
    assert not driver.health()[2]['armed']
    assert emulator.zero
