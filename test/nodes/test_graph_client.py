"""What commands send to a running rig is taken, or they say that it was not."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from geometry_msgs.msg import Vector3Stamped
from in_process import command
from rclpy.service import Service
from sensor_msgs.msg import PointCloud2

from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.loop.points import ESTIMATE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.nodes.client.rig_client import RigClient
from microbot_ros.session.mcap.recording import Recording


@pytest.fixture(autouse=True)
def _soon(patience: Callable[..., None]) -> None:
    """Give up soon what is given up, and ask again soon."""
    patience(ask_s=20 * (1.0,), stop_s=20 * (1.0,), arm_s=(20.0,))


def test_goals_are_taken_each_time_beside_a_recorder_that_was_there_first(
        ros: Any, tmp_path: Path) -> None:
    graph = ros({'recorder': {'folder': str(tmp_path / 'recording')},
                 'controller': {'controller': 'waypoint'}})
    graph.add('recorder')
    goals = graph.add('controller').stage

    def has_path() -> bool:
        """Whether the controller was given a path of its own."""
        return len(goals.path) > 0
    for count in range(1, 6):
        assert graph.microbot('goal', *['10,10'] * count) == (
            0, f"{count} goal{'s' * (count > 1)} accepted by controller 'waypoint'\n", '')
        # They are there when the command ends, and not some time later.
        assert len(goals.goals) == count
    graph.microbot('set', 'controller', 'controller', 'path_following')
    assert graph.microbot('goal', '--path', '0,0', '10,0') == (
        0, "path of 2 points accepted by controller 'path_following'\n", '')
    assert len(goals.goals) == 5
    assert has_path()
    graph.microbot('set', 'controller', 'controller', 'manual')
    for words, what, who in ((('1,1',), 'goals', 'waypoint'),
                             (('--path', '0,0', '9,9'), 'path', 'path_following')):
        status, out, error = graph.microbot('goal', *words)
        assert (status, out) == (1, '')
        assert error.startswith(f'microbot: controller: manual takes no {what}; controllers that '
                                'do: ')
        assert who in error
        assert len(goals.goals) == 5
        assert has_path()
    assert graph.microbot('goal', '--cancel') == (0, 'cancelled\n', '')
    assert len(goals.goals) == 0


@pytest.mark.parametrize(('controller', 'words'), [
    ('waypoint', ('1000,0',)), ('path_following', ('--path', '0,0', '1000,0'))])
def test_goals_outside_the_workspace_are_one_and_the_reason(
        ros: Any, controller: str, words: tuple[str, ...]) -> None:
    graph = ros({'controller': {'controller': controller}})
    particle = np.zeros(1, ESTIMATE)
    for name in ('speed', 'x_std', 'y_std', 'speed_std', 'phi_std'):
        particle[name] = 4e-6 if name == 'speed' else 1e-8
    graph.add('controller')
    seen = graph.probe.create_publisher(PointCloud2, 'model/state', 10)
    graph.probe.create_timer(0.05, lambda: seen.publish(
        messages.cloud(particle, graph.probe.get_clock().now().to_msg())))
    status, out, error = graph.microbot('goal', *words)
    assert (status, out) == (1, '')
    assert error.startswith(f'microbot: {controller}: ')
    assert 'workspace' in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(('words', 'node'), [
    (('goal', '1,1'), 'controller'), (('arm',), 'coil_driver'), (('record',), 'recorder'),
    (('set', 'controller', 'controller', 'hold'), 'controller')])
def test_a_node_that_is_not_there_is_one_and_the_reason(
        patience: Callable[..., None], words: tuple[str, ...], node: str) -> None:
    patience(find_s=0.5)
    assert command(*words, '--namespace', 'nowhere') == (
        1, '', f'microbot: {node} was not found in the namespace /nowhere within 0.5 s: is it '
        'running?\n')


def test_what_is_no_name_is_two() -> None:
    assert command('arm', '--namespace', 'rig 2') == (
        2, '', 'microbot: --namespace: expected a name such as rig_2; received /rig 2\n')
    assert command('set', 'no node', 'a', '1') == (
        2, '', "microbot: expected the name of a node; received 'no node'\n")


def test_each_command_speaks_to_the_rig_of_its_namespace(
        ros: Any, tmp_path: Path, emulator: Any, patience: Callable[..., None]) -> None:
    graph = ros({'recorder': {'recording': False}, 'coil_driver': {'port': emulator.url}})
    nodes = ['controller', 'recorder', 'coil_driver']
    for name in nodes:
        assert graph.add(name, '/rig_2').active
    there, folder = ('--namespace', 'rig_2'), str(tmp_path / 'run')
    assert graph.microbot('set', 'controller', 'controller', 'waypoint', *there)[0] == 0
    status, out, error = graph.microbot('goal', '1,1', *there)
    assert (status, out) == (0, "1 goal accepted by controller 'waypoint'\n")
    assert error.startswith('coil_driver: disarmed')
    assert graph.microbot('record', '--title', 'batch 7', '--folder', folder, *there) == (
        0, f'recording to {folder}\n', '')
    assert graph.microbot('arm', *there)[0] == 0
    assert graph.nodes['rig_2/coil_driver']._driver.gate.armed
    assert graph.microbot('goal', '1,1', *there)[:2] == (
        0, "1 goal accepted by controller 'waypoint'\n")
    assert graph.microbot('record', '--stop', *there) == (0, f'recorded {folder}\n', '')
    with Recording(folder) as recording:
        assert recording.metadata()['recording']['title'] == 'batch 7'
    with graph.spinning(), GraphClient(namespace='rig_2') as client:
        heard: dict[str, str] = {}
        client.watch_health(lambda node, _, sentence, __: heard.setdefault(node, sentence))
        assert client.until(lambda: heard.keys() >= {*nodes}, 30.0)
        assert client.get('controller', 'controller') == {'controller': 'waypoint'}
    patience(find_s=0.5)
    elsewhere = {('goal', '1,1'): 'controller', ('arm', '--off'): 'coil_driver',
                 ('record', '--stop'): 'recorder'}
    for words, node in elsewhere.items():
        assert graph.microbot(*words) == (
            1, '', f'microbot: {node} was not found in the namespace / within 0.5 s: is it '
            'running? There is one in --namespace /rig_2\n')


def test_a_controller_that_does_not_answer_is_one_and_the_reason(
        ros: Any, patience: Callable[..., None]) -> None:
    patience(take_s=1.0)
    graph = ros({'controller': {'controller': 'waypoint'}})
    graph.add('controller').trigger_deactivate()
    assert graph.microbot('goal', '1,1', '--wait', '60') == (
        1, '', 'microbot: controller did not accept the goals within 1 s: it publishes nothing; '
               'is it active?\n')
    assert len(graph.nodes['controller'].stage.goals) == 0


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


def test_a_recorder_whose_answer_was_lost_has_done_it(
        ros: Any, tmp_path: Path, lose: Callable[[str], list[str]]) -> None:
    graph = ros({'recorder': {'recording': False}})
    recorder = graph.add('recorder')
    run, twice = str(tmp_path / 'run'), ('record', '--folder', str(tmp_path / 'other'))
    lost = lose('~/record')
    assert graph.microbot('record', '--folder', run) == (0, f'recording to {run}\n', '')
    assert lost
    assert recorder.health()[1] == f'recording to {run}'
    # Without a loss the same words are a refusal.
    assert graph.microbot(*twice) == (
        1, '', f'microbot: recorder: already recording to {run}\n')
    lost.clear()
    assert graph.microbot('record', '--stop') == (0, 'the recording has ended\n', '')
    assert lost
    assert recorder.health()[1] == 'not recording'
    assert graph.microbot('record', '--stop') == (1, '', 'microbot: recorder: not recording\n')


def _driver_and_commander(ros: Any, emulator: Any) -> tuple[Any, Any]:
    graph = ros({'coil_driver': {'port': emulator.url, 'full_scale_A': 2.0}})
    graph.probe.create_publisher(Vector3Stamped, 'field/command', 1)
    driver = graph.add('coil_driver')
    graph.until(lambda: len(driver._commanders()[0]) == 1)
    return graph, driver


def _requests(driver: Any) -> list[bool]:
    """What the driver is asked from now on: True to arm, False for a zero."""
    asked: list[bool] = []
    arm, zero = driver._driver.arm, driver._driver.request_zero
    driver._driver.arm = lambda epoch: asked.append(True) or arm(epoch)
    driver._driver.request_zero = lambda *why: asked.append(False) or zero(*why)
    return asked


def test_arming_that_was_given_up_does_not_come_true_later(
        ros: Any, emulator: Any, patience: Callable[..., None]) -> None:
    """A driver that hangs while it is asked finds the requests when it goes on."""
    patience(arm_s=(1.0,), stop_s=(0.25, 0.25, 0.5))
    graph, driver = _driver_and_commander(ros, emulator)
    asked = _requests(driver)
    assert command('arm') == (
        1, '', 'microbot: coil_driver did not answer within 1 s; disarm requested; no answer: not '
               'reachable: coil_driver did not answer within 1 s; coils may carry current, switch '
               'the amplifier off by hand\n')
    graph.until(lambda: False in asked)
    graph.until(lambda: driver._driver.zero is Zero.CONFIRMED)
    assert asked.count(True) <= 1
    assert not driver.health()[2]['armed']
    assert emulator.zero


def test_disarming_tells_what_the_driver_answered(
        ros: Any, emulator: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    graph, driver = _driver_and_commander(ros, emulator)
    graph.until(lambda: driver._driver.gate._measured_s > 0)
    assert graph.microbot('arm') == (0, 'armed\n', '')
    assert graph.microbot('arm', '--off') == (
        0, 'disarmed: zero, confirmed by a reading\n', '')
    for zero, words in ((Zero.SENT, 'zero sent, not confirmed'),
                        (Zero.UNREACHABLE, 'not reachable: ')):
        with monkeypatch.context() as patch:
            patch.setattr(CoilDriver, 'zero', zero)
            status, out, error = graph.microbot('arm', '--off')
        assert (status, out) == (1, '')
        assert error.startswith(f'microbot: coil_driver: {words}')
        assert len(error.splitlines()) == 1


def test_a_parameter_may_have_any_name() -> None:
    for name in ('node', 'self'):
        assert inspect.isgenerator(RigClient.set(cast(Any, None), 'controller', **{name: 5}))
