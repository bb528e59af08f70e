"""Recordings through today's nodes: the same answers, or the first point where they part."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import yaml
from builtin_interfaces.msg import Time
from command_line import microbot
from geometry_msgs.msg import PoseArray, Vector3Stamped
from in_process import command, own_context
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from schemas import conforming
from sensor_msgs.msg import MagneticField, PointCloud2

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.control.contract import Controller, ControllerInput, FieldCommand
from microbot_ros.control.deadline_worker import DeadlineWorker
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.plugins.policy import OnnxPolicy
from microbot_ros.control.recorded_worker import (
    BUSY,
    HUNG,
    IN_TIME,
    LATE,
    NotingWorker,
    RepeatingWorker,
)
from microbot_ros.control.testkit import controller_input
from microbot_ros.estimation.batch import fit
from microbot_ros.estimation.online.estimator import Estimates, Estimator
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes import process
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.replay import (
    STAGES,
    Replay,
    Replayed,
    plan_replay,
    recorded_parameters,
)
from microbot_ros.session import read_session
from microbot_ros.session.mcap.cloud import cloud_table
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.replay.compare import compare
from microbot_ros.session.replay.log import PARAMETERS, Entry, header_stamp_ns
from microbot_ros.session.replay.playback import open_source

DATA = Path(__file__).parents[1] / 'data'
STEERING, TRACKING = DATA / 'steering.mcap', DATA / 'tracking.mcap'
ROUNDING = '1e-5'
"""Another processor may round the last bit of a single-precision number otherwise."""


def replay(*words: object) -> tuple[int, str, str]:
    """Return exit status and outputs of `microbot replay`."""
    return command('replay', *words)


@pytest.mark.parametrize(('recording', 'topics', 'fewest'), [
    (TRACKING, {'/particles', '/particles/poses'}, 20),
    (STEERING, {'/model/state', '/field/command', '/coils/command'}, 500)])
def test_todays_nodes_answer_as_they_did(
        tmp_path: Path, recording: Path, topics: set[str], fewest: int) -> None:
    status, out, error = replay(
        recording, '--check', '--tolerance', ROUNDING, '--json', tmp_path / 'a.json')
    assert status == 0, out + error
    assert 'all outputs are equal' in out
    found = json.loads((tmp_path / 'a.json').read_text())
    assert found['same'] is True
    assert {topic['topic'] for topic in found['topics']} == topics
    assert all(topic['compared'] >= fewest for topic in found['topics'])


def test_frames_that_were_let_pass_when_recorded_are_left_out_and_counted(tmp_path: Path) -> None:
    shorter = tmp_path / 'shorter'
    with Recording(STEERING) as whole, RecordingWriter(shorter) as writer:
        for name, content in whole.attachments().items():
            writer.attach(name, content)
        passed = {header_stamp_ns(m.data) for m in [*whole.messages(['/particles'])][100:107]}
        for message in whole.messages(['/particles', '/model/state', '/field/applied',
                                       '/field/command']):
            if message.topic != '/model/state' or header_stamp_ns(message.data) not in passed:
                writer.write(*message)
    status, out, error = replay(
        shorter, '--check', '--node', 'model', '--end', 9, '--tolerance', ROUNDING)
    assert status == 0, out + error
    assert '/model/state: left out 7 of' in error
    assert 'all outputs are equal' in out


def test_a_recording_without_parameters_is_replayed_with_defaults_and_that_is_said(
        tmp_path: Path) -> None:
    bare = tmp_path / 'bare'
    with Recording(STEERING) as whole, RecordingWriter(bare) as writer:
        for message in whole.messages(['/particles', '/model/state', '/field/applied']):
            writer.write(*message)
    _, _, error = replay(bare, '--check', '--node', 'model', '--end', 1)
    assert f'{bare}: no parameters of model in it: defaults are used' in error


def test_what_they_answered_was_more_than_nothing() -> None:
    with Recording(TRACKING) as recording:
        seen = [recording.decode(m).width for m in recording.messages(['/particles'])]
    assert seen[-20:] == 20 * [2]
    with Recording(STEERING) as recording:
        commands = [recording.decode(m).vector for m in recording.messages(['/field/command'])]
    strength = np.hypot([c.x for c in commands], [c.y for c in commands])
    assert (strength > 4.9e-3).sum() > 300
    assert len({(c.x, c.y) for c in commands}) > 50


def test_two_replays_are_the_same_in_every_field(tmp_path: Path) -> None:
    with Recording(STEERING) as source:
        plan = plan_replay(source, STEERING)
        parameters = recorded_parameters(source, plan.nodes, tmp_path)
    assert plan.nodes == ('model', 'controller', 'coil_driver')
    for name in 'ab':
        Replay(STEERING, tmp_path / name, plan, parameters).run()
    with Recording(tmp_path / 'a') as a, Recording(tmp_path / 'b') as b:
        stamps = {header_stamp_ns(m.data) for m in a.messages(['/particles'])}
        found = compare(a, b, ['/particles', '/model/state', '/field/command'], stamps)
    assert all(topic.same for topic in found), found
    assert min(topic.pairs for topic in found) > 500


def test_what_a_change_does_is_shown_at_the_first_point(tmp_path: Path) -> None:
    rig = tmp_path / 'rig.yaml'
    rig.write_text(yaml.safe_dump({'model': {'ros__parameters': {
        'radius_um': 2.3, 'viscosity_mPa_s': 2.49}}}))
    status, out, error = replay(STEERING, '--check', '--node', 'model', '--end', 9,
                                '--config', rig, '--json', tmp_path / 'a.json')
    assert status == 1, out + error
    assert 'answers differ' in out
    [topic] = json.loads((tmp_path / 'a.json').read_text())['topics']
    assert topic['topic'] == '/model/state'
    assert topic['differ'] > 0
    assert topic['only_recorded'] == topic['only_replayed'] == 0
    assert topic['first']['field'].startswith('points.')


@pytest.mark.parametrize(('words', 'expected'), [
    (['nowhere', '--check'], 'nowhere: expected a recording, found nothing'),
    (['FOLDER', '--check'], 'found a folder of CSV files'),
    ([STEERING, '--check', '--rate', '2'], 'expected only without --check'),
    ([STEERING, '--node', 'model'], 'expected only with --check'),
    ([TRACKING, '--check', '--node', 'controller'], 'expected model/state as input of the con'),
    ([STEERING, '--check', '--config', '/nowhere.yaml'], '/nowhere.yaml: expected'),
    ([STEERING, '--check', '--end', 'nan'],
     '--end: expected a time of 0 s or later; received nan'),
    ([STEERING, '--check', '--node', 'steam'], "'steam' is not one of"),
    (['FOLDER', '--rate', '101'], 'rate: expected 0.1 to 100, or inf; received 101'),
    (['FOLDER', '--rate', 'nan'], 'rate: expected 0.1 to 100, or inf; received nan'),
    (['FOLDER', '--start', '-1'], 'start: expected 0 to'),
    (['FOLDER', '--end', 'nan'], 'end: expected 0 s or more; received nan'),
    (['FOLDER', '--topic', 'steam'], 'topics: expected some of /particles; received steam'),
    (['ODD'], "tracks.csv:2: expected a number in 'y_um', found 'nan'"),
    (['EMPTY'], 'expected an MCAP recording, found an empty file'),
    (['BOOL', '--check'], 'expected a PointCloud2 on /particles, found another type'),
])
def test_what_cannot_be_checked_is_one_line_and_two(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[Any],
        expected: str) -> None:
    (tmp_path / 'tracks.csv').write_text('t_s,particle,x_um,y_um\n0,0,0,0\n')
    named = {'FOLDER': tmp_path, 'ODD': tmp_path / 'odd', 'EMPTY': tmp_path / 'odd' / 'a.mcap',
             'BOOL': tmp_path / 'bool'}
    named['ODD'].mkdir()
    (tmp_path / 'odd' / 'tracks.csv').write_text('t_s,particle,x_um,y_um\n0,0,0,nan\n')
    if 'EMPTY' in words:
        named['EMPTY'].write_bytes(b'')
    if 'BOOL' in words:
        with RecordingWriter(named['BOOL']) as writer:
            for topic in ('/particles', '/model/state'):
                writer.write(topic, 'std_msgs/msg/Bool', 10**9, b'\0\1\0\0\1')
    status = microbot('replay', *(named.get(word, word) for word in words))
    said = capsys.readouterr()
    assert status == 2, said
    assert len(said.err.strip().splitlines()) == 1
    assert expected in said.err


def beginning(session: Session, seconds: float) -> Session:
    """The first seconds of a session."""
    tracks, commands = session.tracks, session.commands
    end = tracks.t[0] + seconds
    seen, given = tracks.t <= end, commands.t <= end
    assert commands.frequency is not None
    return replace(
        session, tracks=tracks.rows(seen),
        commands=Commands(commands.t[given], commands.field[given], commands.frequency[given]))


def filtered(session: Session, conditions: Conditions) -> Estimates:
    """The last answer of the estimator that the model node runs, without any ROS."""
    estimator, tracks, commands = Estimator(conditions), session.tracks, session.commands
    assert commands.frequency is not None
    for k, t in enumerate(commands.t):
        estimator.command(t, commands.field[k], commands.frequency[k])
    for t in np.unique(tracks.t):
        rows = tracks.t == t
        estimates = estimator.update(
            t, tracks.particle[rows], tracks.position[rows], tracks.sigma[rows])
    return estimates


def test_a_rolling_robot_is_the_same_by_topics_as_by_rows(
        recordings: Path, tmp_path: Path) -> None:
    source = recordings / 'rolling_robot'
    rows = beginning(read_session(source), 40.0)
    with open_source(source) as played:
        plan = plan_replay(played, source, ['model'])
    parameters = {'model': {'propulsion': 'rolling'}}
    Replay(source, tmp_path / 'run', plan, parameters, end_s=40.0).run()
    by_topics = read_session(tmp_path / 'run')
    # Positions cross in single precision, nothing else is lost.
    assert by_topics.tracks.position == pytest.approx(rows.tracks.position, rel=1e-7)
    ours, theirs = fit(by_topics), fit(rows)
    assert ours.polar.speed == pytest.approx(theirs.polar.speed, rel=1e-5)
    assert ours.polar.phi == pytest.approx(theirs.polar.phi, abs=1e-5)
    with Recording(tmp_path / 'run') as recording:
        states = list(recording.messages(['/model/state']))
        last = cloud_table(recording.decode(states[-1]))
    assert len(states) == len(np.unique(rows.tracks.t))
    estimates = filtered(rows, Conditions('rolling', 2.3e-6, 1e-3, 298.0))
    assert last['speed_std'] == pytest.approx(estimates.speed_std, rel=1e-3)
    for name in ('speed', 'phi'):
        apart = np.abs(last[name] - getattr(estimates, name))
        assert apart < 1e-3 * getattr(estimates, f'{name}_std')


# Beside a live rig ------------------------------------------------------------------------------

def past(folder: Path) -> Path:
    """A recording of somebody sending commands and a goal for 3 s."""
    session = folder / 'past'
    with RecordingWriter(session) as writer:
        for k in range(90):
            t_ns = 10**18 + k * 33_000_000
            stamp = Time(sec=t_ns // 10**9, nanosec=t_ns % 10**9)
            field = messages.field_vector(np.array([5e-3, 0.0]), stamp)
            writer.write('/field/command', 'geometry_msgs/msg/Vector3Stamped', t_ns,
                         serialize_message(field))
            goals = messages.poses(np.array([[1e-5, 0.0]]), np.zeros(1), stamp)
            writer.write('/goals', 'geometry_msgs/msg/PoseArray', t_ns, serialize_message(goals))
    return session


def playing(graph: Any, monkeypatch: pytest.MonkeyPatch, *words: object,
            ) -> tuple[int, list[str]]:
    """`microbot replay` beside a graph: its exit status, and what it says on standard error.

    What is for a process of its own is left out: real-time priority and a frozen heap.
    """
    for name in ('_settle', 'set_realtime_priority_of_all'):
        monkeypatch.setattr(process, name, lambda *_: None)
    with graph.spinning(), own_context():
        status, _, error = command('replay', *words)
    return status, error.strip().splitlines()


def test_beside_a_live_coil_driver_a_replay_is_refused_and_drives_nothing(
        ros: Any, emulator: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = ros({'coil_driver': {'port': emulator.url}})
    driver = graph.add('coil_driver')
    fields = graph.hear(Vector3Stamped, 'field/command')
    status, errors = playing(
        graph, monkeypatch, past(tmp_path), '--topic', 'field/command')
    assert status == 1
    [line] = errors
    assert '/coil_driver is live' in line
    assert '--into-live-rig' in line
    assert fields == []
    assert driver.active
    status, errors = playing(
        graph, monkeypatch, past(tmp_path / 'again'), '--topic', 'field/command',
        '--into-live-rig')
    assert (status, errors) == (0, [])
    graph.until(lambda: len(fields) >= 90)
    assert len(fields) == 90


@pytest.mark.parametrize('follows', [False, True])
def test_a_live_controller_gets_no_goals_of_the_past_one_that_follows_the_clock_does(
        ros: Any, tmp_path: Path, follows: bool) -> None:
    graph = ros({'player': {'session': str(past(tmp_path)), 'topics': ['goals'], 'rate': 100.0},
                 'controller': {'use_sim_time': follows, 'controller': 'waypoint'}})
    controller = graph.add('controller')
    player = graph.add('player')
    graph.until(lambda: player.finished)
    assert player.fault.startswith('' if follows else '/controller is live')
    assert bool(player.fault) is not follows
    assert len(controller.stage.goals) == follows


def test_a_replay_ends_when_a_rig_comes_alive(ros: Any, emulator: Any, tmp_path: Path) -> None:
    graph = ros({'player': {'session': str(past(tmp_path)), 'topics': ['field/command'],
                            'loop': True},
                 'coil_driver': {'port': emulator.url}})
    fields = graph.hear(Vector3Stamped, 'field/command')
    player = graph.add('player')
    graph.until(lambda: fields)
    graph.add('coil_driver')
    graph.until(lambda: player.finished)
    assert player.fault.startswith('/coil_driver is live')


# What each answer was made from -----------------------------------------------------------------

FRAMES = 90
KEPT = ['particles', 'field/applied', 'model/state', 'field/command', 'goals', 'loop/log',
        '/parameter_events']


def steered_live(ros: Any, folder: Path) -> Path:
    """Two particles, goals, a switch of controllers and poses that come too late, live."""
    out = folder / 'live'
    graph = ros({'recorder': {'folder': str(out), 'topics': KEPT},
                 'model': {'radius_um': 10.0, 'viscosity_mPa_s': 1.245},
                 'controller': {'pose_timeout_ms': 800.0}})
    for name in ('recorder', 'model', 'controller'):
        graph.add(name)
    states = graph.hear(PointCloud2, 'model/state')
    fields = graph.hear(Vector3Stamped, 'field/command')
    particles = graph.probe.create_publisher(PointCloud2, 'particles', 10)
    applied = graph.probe.create_publisher(MagneticField, 'field/applied', 10)
    goals = graph.probe.create_publisher(PoseArray, 'goals', 10)
    topics = [graph.probe.resolve_topic_name(topic) for topic in KEPT]
    graph.until(lambda: particles.get_subscription_count() == 2
                and applied.get_subscription_count() == goals.get_subscription_count() == 2
                and all(graph.probe.count_publishers(topic) for topic in topics))
    graph.until(lambda: {'model', 'controller'} <= graph.nodes['recorder']._collector.answered)
    points = np.zeros(2, PARTICLE)
    points['id'], points['sigma'] = [1, 2], 1e-8
    rng = np.random.default_rng(5)
    answered, place, before = 0, np.zeros((2, 2)), None
    for frame in range(FRAMES):
        now = graph.probe.get_clock().now().nanoseconds * 1e-9
        if before is not None:  # they swim along the field of the frame before
            place = place + 15e-6 * (now - before) * np.array(
                [np.cos((frame - 1) / 9), np.sin((frame - 1) / 9)])
        before = now
        for k in range(3):
            angle = frame / 9 - 0.02 * k
            field = 5e-3 * np.array([np.cos(angle), np.sin(angle)])
            applied.publish(messages.magnetic_field(field, messages.to_stamp(now - 4e-3 * k)))
        if frame in (20, 60):
            goals.publish(messages.poses(
                rng.normal(0, 2e-5, (2, 2)), np.zeros(2), messages.to_stamp(now)))
        if frame in (10, 50):
            name = Parameter('controller', value='waypoint' if frame == 10 else 'formation')
            graph.call(SetParameters, 'controller/set_parameters',
                       SetParameters.Request(parameters=[name.to_parameter_msg()]))
        points['x'], points['y'] = (place + rng.normal(0, 1e-8, (2, 2))).T
        late = frame in (30, 31, 70)
        stamp = now if not late else now - 1.0 + frame * 1e-3
        particles.publish(messages.cloud(points, messages.to_stamp(stamp)))
        answered += not late
        graph.until(lambda frame=frame: len(states) > frame)
        graph.until(lambda answered=answered: sum(
            any(field.header.stamp == state.header.stamp for state in states[-9:])
            for field in fields[-9:]) >= min(answered, 5))
    writer = graph.nodes['recorder']._writer
    graph.until(lambda: writer.status().counts.get('/loop/log', 0) >= 2 * FRAMES)
    graph.nodes['recorder'].trigger_deactivate()
    with Recording(out) as recording:
        for line in recording.messages(['/loop/log']):
            conforming('loop/log', recording.decode(line).data)
    return out


@pytest.fixture
def steered(ros: Any, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `steered_live` leaves behind, made once: nobody changes it."""
    kept = tmp_path_factory.getbasetemp() / 'live'
    if not kept.is_dir():
        steered_live(ros, tmp_path).rename(kept)
    return kept


def copied(source: Path, out: Path, apart_ms: float, without: str = 'nothing') -> Path:
    """A recording as a busy recorder would have made it: each topic in its order, but up to so
    much later than the others; without topics of that name."""
    rng = np.random.default_rng(8)
    with Recording(source) as whole, RecordingWriter(out) as writer:
        for name, content in whole.attachments().items():
            writer.attach(name, content)
        moved = []
        for topic in whole.topics:
            kept = [*whole.messages([topic])]
            late = rng.uniform(0, apart_ms * 1e6, len(kept)).astype(int).tolist()
            times = sorted(m.t_ns + delay for m, delay in zip(kept, late, strict=True))
            moved += [m._replace(t_ns=t) for m, t in zip(kept, times, strict=True)
                      if not topic.endswith(without)]
        for message in sorted(moved, key=lambda m: m.t_ns):
            writer.write(*message)
    return out


def test_a_recording_that_came_in_another_order_is_answered_alike(
        steered: Path, tmp_path: Path) -> None:
    shuffled = copied(steered, tmp_path / 'shuffled', 80.0)
    with Recording(shuffled) as recording:
        frames, commands = ({header_stamp_ns(m.data) for m in recording.messages([topic])}
                            for topic in ('/model/state', '/field/command'))
    answered = len(frames & commands)  # a busy machine lets a frame grow too old
    assert answered > FRAMES / 2
    for nodes in ([], ['--node', 'model'], ['--node', 'controller']):
        status, out, error = replay(shuffled, '--check', *nodes, '--json', tmp_path / 'a.json')
        assert status == 0, out + error
        found = {topic['topic']: topic
                 for topic in json.loads((tmp_path / 'a.json').read_text())['topics']}
        assert all(topic['not_judged'] == {} for topic in found.values())
        if nodes != ['--node', 'controller']:
            assert found['/model/state']['compared'] == FRAMES
        if nodes != ['--node', 'model']:
            assert found['/field/command']['compared'] == answered
    with Recording(shuffled) as recording:
        fields = [recording.decode(m).vector for m in recording.messages(['/field/command'])]
    # How many it were depends on when the switches came through.
    assert len({(field.x, field.y) for field in fields}) > 10


def test_without_the_log_the_answers_are_the_same_within_what_is_promised(
        steered: Path, tmp_path: Path) -> None:
    shuffled = copied(steered, tmp_path / 'shuffled', 0.0, 'log')
    status, out, error = replay(shuffled, '--check', '--node', 'model',
                                '--json', tmp_path / 'a.json')
    assert status == 0, out + error
    [topic] = json.loads((tmp_path / 'a.json').read_text())['topics']
    assert topic['differ'] == topic['only_recorded'] == topic['only_replayed'] == 0
    assert topic['compared'] > 0.98 * FRAMES


def test_what_was_not_recorded_is_named(steered: Path, tmp_path: Path) -> None:
    lacking = copied(steered, tmp_path / 'lacking', 0.0, 'goals')
    status, out, error = replay(lacking, '--check', '--node', 'controller')
    assert status == 0, out + error
    assert 'cannot be compared: what the controller received on goals was not rec' in out


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The networks that are loaded, and so executed."""
    paths: list[str] = []

    def load(self: OnnxPolicy, path: Path) -> None:
        paths.append(str(path))
        self.particles = 1
    monkeypatch.setattr(OnnxPolicy, '__init__', load)
    return paths


@pytest.mark.parametrize('named', ['', 'mine.onnx'])
def test_a_network_that_a_recording_sets_is_not_executed(
        loaded: list[str], named: str) -> None:
    values = {'controller': 'hold'} | ({'policy.file': named} if named else {})
    stage = next(stage for stage in STAGES if stage.node == 'controller')
    node = type('It', (Replayed, stage.core), {})(stage, values, lambda *_: None)
    assert set(loaded) == {named} - {''}
    node.be_given(Entry(PARAMETERS, {'policy.file': '/tmp/theirs.onnx', 'delay_ms': 7.0}, 1))
    assert '/tmp/theirs.onnx' not in loaded
    assert node.settings.delay_ms == 7.0
    assert 'does not execute' in node.withheld


@pytest.mark.parametrize('drove', ['hold', 'policy'])
def test_a_network_is_named_on_the_command_line_or_left_out(tmp_path: Path, drove: str) -> None:
    with RecordingWriter(tmp_path / 'run') as writer:
        writer.attach('parameters/controller.yaml', yaml.safe_dump({'controller': {
            'ros__parameters': {'controller': drove, 'policy.file': '/tmp/theirs.onnx'}}}))
        writer.attach('/tmp/theirs.onnx', b'x')
        writer.write('/t', 'std_msgs/msg/String', 1, b'')
    with Recording(tmp_path / 'run') as recording:
        def found(policy: Path | None) -> Any:
            values = recorded_parameters(recording, ['controller'], tmp_path, policy)
            return values['controller']['policy.file']
        assert found(Path('/my/own.onnx')) == '/my/own.onnx'
        if drove == 'policy':
            with pytest.raises(InputError, match='--policy FILE'):
                found(None)
        else:
            assert found(None) == ''


class Slow(Controller):
    """Counts its ticks; in some of them it waits until it is let go on."""

    interface_version = 1
    summary = 'Slow.'
    waits: ClassVar[set[int]] = set()
    let = threading.Event()

    def __init__(self) -> None:
        super().__init__()
        self.ticks = 0

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        self.ticks += 1
        if self.ticks in self.waits:
            self.let.wait(10.0)
        return FieldCommand(np.array([1e-4 * self.ticks, 0.0]))


def board(worker: Callable[[float], DeadlineWorker]) -> ControllerManager:
    return ControllerManager({'slow': Slow()}, 'slow', deadline=0.1, patience=0.4, border=0.0,
                       worker=worker)


def test_what_came_too_late_comes_out_the_same_without_any_hurry(
        monkeypatch: pytest.MonkeyPatch) -> None:
    verdicts: list[str] = []
    monkeypatch.setattr(Slow, 'waits', {3})
    live = board(lambda patience: NotingWorker(patience, verdicts.append))
    before = [live.tick(controller_input(t=0.01 * k, dt=0.01)) for k in range(6)]
    hung = time.monotonic() + 0.5
    while time.monotonic() < hung:
        before.append(live.tick(controller_input(t=0.01 * len(before), dt=0.01)))
    monkeypatch.setattr(Slow, 'waits', set())
    before += [live.tick(controller_input(t=0.01 * (len(before) + k), dt=0.01)) for k in range(4)]
    assert set(verdicts) == {IN_TIME, LATE, BUSY, HUNG}
    kept = iter(verdicts)
    again = board(lambda patience: RepeatingWorker(patience, lambda: next(kept)))
    for k, outcome in enumerate(before):
        now = again.tick(controller_input(t=0.01 * k, dt=0.01))
        assert now.result == outcome.result
        assert now.command is not None
        assert outcome.command is not None
        assert now.command.field.tolist() == outcome.command.field.tolist()
    Slow.let.set()


# Ending -----------------------------------------------------------------------------------------

@pytest.mark.rig
@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_ends_a_check_at_once_and_leaves_nothing(
        tmp_path: Path, number: signal.Signals) -> None:
    scratch = tmp_path / 'scratch'
    scratch.mkdir()
    process = subprocess.Popen(
        [sys.executable, '-m', 'microbot_ros.cli', 'replay', str(STEERING), '--check'],
        env={**os.environ, 'TMPDIR': str(scratch)}, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60.0
    while not [*scratch.rglob('replayed_0.mcap')]:
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(number)
    process.wait(10.0)
    assert process.returncode in (128 + number, 130)
    assert [*scratch.iterdir()] == []
    commands = [path.read_bytes() for path in Path('/proc').glob('[0-9]*/cmdline')
                if path.exists()]
    assert not any(str(scratch).encode() in command for command in commands)
