"""The main job on one real graph: order and cause, and no times."""

from __future__ import annotations

import json
import time
from typing import Any

import cv2
import numpy as np
import pytest
from in_process import command
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from smoke.conftest import NODES, PHIS_RAD, SPEEDS_UM_S, SmokeRig

from microbot_ros.cli.demo import demo
from microbot_ros.cli.demo.robots import KINDS
from microbot_ros.common.records import Commands
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.session import read_session
from microbot_ros.session.mcap.recording import Recording

pytestmark = [pytest.mark.xdist_group('smoke'), pytest.mark.timeout(400)]

RECORDED = {'/particles', '/model/state', '/field/command', '/field/applied', '/coils/command',
            '/coils/applied', '/coils/measured', '/camera/image_raw', '/diagnostics', '/goals',
            '/virtual_rig/truth'}


def test_the_loop_closes_and_a_particle_reaches_its_goal(rig: SmokeRig) -> None:
    rig.learn()
    first = rig.estimates[rig.estimates['id'].argmin()]
    goal = rig.goal = np.array([first['x'] + 12e-6, first['y'] + 8e-6], float)
    rig.drive('waypoint')
    taken = rig.client.send_goals([tuple(goal.tolist())])
    assert taken.controller == 'waypoint'
    reached: list[float] = []

    def arrived() -> bool:
        here = rig.estimates[rig.estimates['id'] == first['id']]
        if rig.progress.get('done') == 'True' and len(here):
            reached.append(float(np.hypot(here['x'][0] - goal[0], here['y'][0] - goal[1])))
        return bool(reached)
    rig.until(arrived)
    assert reached[0] < 5e-6
    assert any(any(entry['currents_A']) for entry in rig.entries())


def test_estimates_are_near_the_truth(rig: SmokeRig) -> None:
    rig.learn()
    for found in rig.estimates:
        off_v = (found['speed'] * 1e6 - np.array(SPEEDS_UM_S)) / SPEEDS_UM_S
        off_phi = np.angle(np.exp(1j * (found['phi'] - np.array(PHIS_RAD))))
        assert (np.hypot(off_v, off_phi) < 0.3).any(), found


def test_a_raw_subscriber_gets_what_is_published(rig: SmokeRig) -> None:
    heard: list[bytes] = []
    rig.client.node.create_subscription(PointCloud2, 'particles', heard.append, 10, raw=True)
    rig.until(lambda: heard)
    cloud = deserialize_message(heard[-1], PointCloud2)
    assert cloud.header.frame_id == messages.WORKSPACE
    assert len(messages.points(cloud, PARTICLE)) == cloud.width


def test_a_goal_of_the_command_is_reached(rig: SmokeRig) -> None:
    rig.learn()
    rig.drive('waypoint')
    first = rig.estimates[rig.estimates['id'].argmin()]
    x_um, y_um = first['x'] * 1e6 - 8, first['y'] * 1e6 - 5
    done = rig.microbot('goal', '--wait', '90', '--', f'{x_um:.1f},{y_um:.1f}')
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith('arrived\n')


def test_a_controller_is_switched_and_an_unknown_one_is_refused(rig: SmokeRig) -> None:
    done = rig.microbot('set', 'controller', 'controller', 'steam')
    assert done.returncode == 2
    assert "no controller 'steam'" in done.stderr
    for name in ('path_following', 'hold'):
        done = rig.microbot('set', 'controller', 'controller', name)
        assert done.returncode == 0, done.stderr
        rig.until(lambda name=name: rig.progress['controller'] == name)


def test_disarming_ends_what_flows_and_arming_lets_it_flow_again(rig: SmokeRig) -> None:
    rig.drive('open_loop')
    rig.until(lambda: not rig.zero)
    rig.driven = False
    # A process that is held up may read zero back too late, and the command then says so.
    rig.until(lambda: rig.microbot('arm', '--off').returncode == 0)
    assert rig.zero  # when the command ends, and not some time later
    count = len(rig.entries())
    rig.until(lambda: not rig.armed)
    states = rig.progress
    rig.until(lambda: rig.progress is not states)  # the controller goes on to command
    assert len(rig.entries()) == count
    rig.client.set('controller', controller='hold')
    done = rig.microbot('arm')
    rig.driven = done.returncode != 0  # the check is of milliseconds: a busy machine may fail it
    rig.drive('open_loop')
    rig.until(lambda: not rig.zero)
    rig.rest()


def test_every_node_says_how_it_is(rig: SmokeRig) -> None:
    rig.until(lambda: rig.health.keys() >= set(NODES))
    assert not [name for name, (level, _) in rig.health.items()
                if level == b'\x02' and name != 'coil_driver'], rig.health


def test_a_recording_holds_every_topic(rig: SmokeRig) -> None:
    done = rig.microbot('record', '--stop')
    assert done.returncode == 0, done.stderr
    with Recording(rig.recording) as recording:
        assert recording.complete
        assert {name for name, topic in recording.topics.items() if topic.count} >= RECORDED
        assert recording.metadata()['recording']['title'] == 'smoke'
        assert f'parameters/{NODES[1]}.yaml' in recording.attachments()


def test_a_recording_begins_and_ends_by_a_command(rig: SmokeRig) -> None:
    folder = rig.folder / 'again'
    for words, status in ((['--folder', folder], 0), (['--folder', folder], 1), (['--stop'], 0)):
        done = rig.microbot('record', *words)
        assert done.returncode == status, done.stderr
        if status:
            assert f'already recording to {folder}' in done.stderr
        rig.client.spin(0.5)
    with Recording(folder) as recording:
        assert recording.complete


def test_a_replay_beside_a_live_rig_is_refused(rig: SmokeRig) -> None:
    done = rig.microbot('replay', rig.recording, '--topic', 'goals')
    assert done.returncode == 1
    assert 'is live' in done.stderr


def test_a_stop_leaves_zero_and_every_node_ends_by_itself(rig: SmokeRig) -> None:
    rig.drive('open_loop')
    rig.until(lambda: not rig.zero)
    rig.driven = False
    rig.graph.stop([*NODES])
    assert not rig.graph.killed
    last = rig.entries()[-1]
    assert not any(last['currents_A'])
    assert last['cause'] != 'power_off'
    assert rig.graph.count == 1  # the amplifier, which nobody needed to switch off


# What was recorded, without the graph ----------------------------------------------------------

def test_the_demo_draws_what_was_recorded(rig: SmokeRig) -> None:
    robots = KINDS['catalytic'](rig.folder)
    run = demo._Run(rig.goal[None], rig.began_s, ['hold', 'open_loop', 'waypoint'], [])
    summary = demo._look_back(rig.folder, rig.folder, run, robots, rig.began_s)
    assert summary['goals_reached'] == summary['goals'] == 1
    assert len(summary['estimate']) == len(SPEEDS_UM_S)
    assert summary['frames'] > 100
    assert summary['amplifier']['crc_errors'] == 0
    assert cv2.imread(str(rig.folder / 'demo.png')).std() > 10
    assert cv2.VideoCapture(str(rig.folder / 'demo.mp4')).read()[0]


def _offline(rig: SmokeRig, *words: object) -> dict[str, Any]:
    out = rig.folder / 'answer.json'
    status, said, error = command(*words, '--json', out)
    assert status == 0, said + error
    found: dict[str, Any] = json.loads(out.read_text())
    return found


def test_info_shows_what_is_in_the_recording(rig: SmokeRig) -> None:
    status, said, error = command('info', rig.recording)
    assert status == 0, error
    assert all(topic in said for topic in RECORDED)


def _acted(rig: SmokeRig, commands: Commands) -> float:
    """For which part of the time with a command currents flowed: while a busy machine pauses the
    driver, the amplifier's watchdog zeroes them."""
    with Recording(rig.recording) as recording:
        began_s, ended_s = recording.start_ns / 1e9, recording.end_ns / 1e9
    t = np.linspace(0.0, ended_s - began_s, 10_000)
    log = rig.entries()
    changed = np.array([entry['t_monotonic_s'] for entry in log]) + time.time() - time.monotonic()
    flows = np.array([any(entry['currents_A']) for entry in log])
    commanded = np.array([commands.field_at(one).any() for one in t])
    return float(flows[np.searchsorted(changed, t[commanded] + began_s, side='right') - 1].mean())


def test_fit_finds_in_the_recording_what_swam(rig: SmokeRig) -> None:
    session = read_session(rig.recording)
    assert len(np.unique(session.tracks.particle)) >= len(SPEEDS_UM_S)
    found = _offline(rig, 'fit', rig.recording, '--out', rig.folder / 'fit')
    speeds = [one['v_um_s']['value'] for one in found['particles'].values()]
    assert len(speeds) >= len(SPEEDS_UM_S)
    assert min(speeds) > 0.5 * _acted(rig, session.commands) * min(SPEEDS_UM_S)
    assert max(speeds) < 1.5 * max(SPEEDS_UM_S)


def test_the_model_answers_the_recording_as_it_did(rig: SmokeRig) -> None:
    found = _offline(rig, 'replay', rig.recording, '--check', '--node', 'model')
    assert found['same'] is True
    assert found['topics'][0]['compared'] > 50
