"""A session played through topics: the model node learns from it what was put in."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import MagneticField, PointCloud2
from std_srvs.srv import SetBool, Trigger

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.loop.points import ESTIMATE, PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.player import PlaybackPublishers
from microbot_ros.session import write_session

SPEED, PHI = np.array([3.7e-6, 4.9e-6]), np.array([-1.1, 2.6])
ORIGIN = 1.0
"""Of a session in ROS time [s]: its first row, a command, with the tracks from a frame later."""
DIFFUSION, LOCALISATION = 0.05e-12, 0.05e-6


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Two particles for 12 s at 30 Hz under a field that turns by steps; Brownian, seeded."""
    rng = np.random.default_rng(7)
    t = np.arange(360) / 30
    angle = np.array([0.0, 2.0, 4.0, 1.0, 5.0, 3.0])[np.minimum(t // 2, 5).astype(int)]
    steps = SPEED[:, None] * np.exp(1j * (PHI[:, None] + angle)) / 30
    walk = rng.normal(0, math.sqrt(2 * DIFFUSION / 30), (2, 2, 360))
    path = np.cumsum(steps + walk[0] + 1j * walk[1], axis=1)
    seen = path + LOCALISATION * (rng.normal(size=path.shape) + 1j * rng.normal(size=path.shape))
    # A displacement reaches the frame after the command: commands are stamped a frame earlier.
    tracks = Tracks(np.repeat(t, 2), np.tile([0, 1], 360),
                    np.stack([seen.real, seen.imag], -1).transpose(1, 0, 2).reshape(-1, 2),
                    np.full(720, np.nan), np.full(720, LOCALISATION))
    commands = Commands(t - 1 / 30, 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    folder = tmp_path / 'session'
    write_session(folder, Session(tracks, commands, Conditions(radius=2.3e-6)))
    return folder


def test_what_is_played_is_what_the_model_learns(ros: Any, session: Path) -> None:
    graph = ros({'model': {'field_source': 'command', 'radius_um': 2.3, 'use_sim_time': True,
                           'viscosity_mPa_s': 1.245},
                 'player': {'session': str(session), 'rate': 10.0}})
    states = graph.hear(PointCloud2, 'model/state')
    assert graph.add('model').active, graph.nodes['model'].fault
    assert graph.add('player').active, graph.nodes['player'].fault
    graph.until(lambda: graph.nodes['player'].finished)
    assert graph.nodes['player'].fault == ''
    graph.until(lambda: messages.to_seconds(states[-1].header.stamp) == ORIGIN + 12.0)
    last = messages.points(states[-1], ESTIMATE)
    assert last['id'].tolist() == [0, 1]
    assert np.abs(last['speed'] - SPEED).max() < 4 * last['speed_std'].max()
    assert np.abs(np.angle(np.exp(1j * (last['phi'] - PHI)))).max() < 4 * last['phi_std'].max()
    assert last['speed_std'].max() < 0.2e-6
    ahead = np.hypot(last['x_ahead'] - last['x'], last['y_ahead'] - last['y'])
    assert ahead == pytest.approx(0.5 * last['speed'], rel=0.02)
    assert (last['ahead_std'] > last['x_std']).all()
    drag = 6 * math.pi * 1.245e-3 * 2.3e-6
    assert last['force'] == pytest.approx(drag * last['speed'], rel=1e-4)


def test_a_player_pauses_and_steps(ros: Any, session: Path) -> None:
    graph = ros({'player': {'session': str(session), 'rate': 1.0, 'topics': ['particles']}})
    particles = graph.hear(PointCloud2, 'particles')
    assert graph.add('player').active
    graph.until(lambda: particles)
    assert graph.call(SetBool, 'player/pause', SetBool.Request(data=True)).success
    sent = graph.nodes['player']._sent
    assert graph.call(Trigger, 'player/step', Trigger.Request()).success
    assert graph.nodes['player']._sent == sent + 1


def play(ros: Any, session: Path, **parameters: Any) -> tuple[Any, list[float], list[float]]:
    """A player of particles alone; the stamps [s] and the clock as they are heard."""
    graph = ros({'player': {'session': str(session), 'topics': ['particles'], **parameters}})
    stamps: list[float] = []
    clock: list[float] = []
    graph.probe.create_subscription(PointCloud2, 'particles', lambda m: stamps.append(
        messages.to_seconds(m.header.stamp) - ORIGIN), 1000)
    graph.probe.create_subscription(
        Clock, '/clock', lambda m: clock.append(messages.to_seconds(m.clock) - ORIGIN), 1000)
    return graph, stamps, clock


def tell(graph: Any, **values: Any) -> Any:
    """The answer to setting parameters of the player."""
    return graph.call(SetParameters, 'player/set_parameters', SetParameters.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        )).results[0]


def test_from_here_to_there_at_the_pace_of_its_clock(ros: Any, session: Path) -> None:
    graph, stamps, clock = play(ros, session, rate=5.0, start_s=2.0, end_s=9.0)
    player = graph.add('player')
    graph.until(lambda: player.finished)
    graph.until(lambda: stamps and stamps[-1] > 8.99)
    assert stamps == pytest.approx(np.arange(60, 271) / 30, abs=1e-6)
    assert (np.diff(clock) >= 0).all()
    assert clock[-1] <= 9.0
    assert len(clock) > 10


@pytest.mark.parametrize('rate', [0.1, 100.0])
def test_the_slowest_and_the_fastest_rate_are_taken(
        ros: Any, session: Path, rate: float) -> None:
    graph, stamps, _ = play(ros, session, rate=rate)
    player = graph.add('player')
    graph.until(lambda: player.finished if rate > 1 else stamps)
    assert player.fault == ''
    if rate > 1:
        graph.until(lambda: stamps[-1] > 11.9)


def test_as_fast_as_it_goes_nothing_is_lost(ros: Any, session: Path) -> None:
    graph, stamps, _ = play(ros, session, rate=0.0)
    node = graph.add('player')
    graph.call(SetBool, 'player/pause', SetBool.Request(data=True))
    assert tell(graph, seek_s=6.0).successful
    stamps.clear()
    graph.call(SetBool, 'player/pause', SetBool.Request(data=False))
    graph.until(lambda: node.finished)
    graph.until(lambda: stamps and stamps[-1] > 11.9)
    assert stamps == pytest.approx(np.arange(180, 361) / 30, abs=1e-6)


def test_who_comes_before_anybody_else_misses_nothing(ros: Any, session: Path) -> None:
    graph = ros({'player': {'session': str(session), 'topics': ['particles'], 'rate': 100.0}})
    node = graph.add('player')
    graph.until(lambda: node.health()[1].startswith('waiting for listeners'))
    heard = graph.hear(PointCloud2, 'particles', 1000)
    graph.until(lambda: node.finished)
    graph.until(lambda: len(heard) == 360)


def test_it_is_played_to_nobody_in_the_end(
        ros: Any, session: Path, patience: Callable[..., None]) -> None:
    patience(listeners_s=0.2)
    node = (graph := ros({'player': {'session': str(session), 'rate': 0.0}})).add('player')
    graph.until(lambda: node.finished)
    assert node.health()[2] == {'messages_sent': 720}


def test_a_listener_that_keeps_all_is_waited_for(
        ros: Any, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = itertools.count()
    send = PlaybackPublishers.send
    monkeypatch.setattr(PlaybackPublishers, 'send', lambda self, topic, data: (
        next(calls) % 5 > 0 and send(self, topic, data)))
    graph, stamps, clock = play(ros, session, rate=0.0)
    node = graph.add('player')
    graph.until(lambda: node.finished)
    graph.until(lambda: len(stamps) == 360)
    assert stamps == pytest.approx(np.arange(1, 361) / 30, abs=1e-6)
    assert next(calls) == 360 * 5 // 4
    assert (np.diff(clock) >= 0).all()
    assert 'keeps all' in node._complaint


def test_a_loop_begins_again(ros: Any, session: Path) -> None:
    # If a loop passes between two turns of the node, as on a busy machine, the clock stands still.
    graph, stamps, clock = play(ros, session, rate=2.0, start_s=11.0, loop=True)
    node = graph.add('player')
    graph.until(lambda: len(stamps) > 70 and (np.diff(clock) < 0).any())
    assert not node.finished
    assert set(np.round(np.multiply(stamps, 30)).astype(int)) == set(range(330, 361))
    assert min(np.diff(stamps)) < -0.9


def test_rate_and_place_change_while_it_plays(ros: Any, session: Path) -> None:
    graph, stamps, _ = play(ros, session, rate=0.5)
    node = graph.add('player')
    graph.until(lambda: stamps)
    assert tell(graph, seek_s=10.0).successful
    graph.until(lambda: stamps[-1] >= 10.0)
    assert not tell(graph, rate=101.0).successful
    assert not tell(graph, rate=float('nan')).successful
    refused = tell(graph, seek_s=12.5)
    assert not refused.successful
    assert 'seek: expected 0 to 12 s; received 12.5' in refused.reason
    assert not tell(graph, rate=0.05).successful
    assert node.settings.seek_s == 10.0
    assert tell(graph, rate=100.0).successful
    graph.until(lambda: node.finished)


@pytest.mark.parametrize(('parameters', 'expected'), [
    ({}, 'expected a parameter session'),
    ({'session': '/nowhere'}, '/nowhere'),
    ({'session': 'SESSION', 'topics': ['steam']}, 'no topic /steam'),
])
def test_what_cannot_be_played_is_one_clear_line(
        ros: Any, session: Path, parameters: dict[str, Any], expected: str) -> None:
    parameters = {k: str(session) if v == 'SESSION' else v for k, v in parameters.items()}
    node = ros({'player': parameters}).add('player')
    assert not node.active
    assert expected in node.fault


def test_a_bad_model_file_is_refused_and_the_model_kept(ros: Any, tmp_path: Path) -> None:
    graph = ros({'model': {}})
    node = graph.add('model')
    before = node.stage.estimator.model
    bad = tmp_path / 'model.yaml'
    bad.write_text('effects:\n  warp_drive: {}\n')

    def answer(value: str) -> Any:
        parameter: ParameterMessage = Parameter('model_file', value=value).to_parameter_msg()
        return graph.call(SetParameters, 'model/set_parameters',
                          SetParameters.Request(parameters=[parameter])).results[0]
    refused = answer(str(bad))
    assert not refused.successful
    assert str(bad) in refused.reason
    assert answer('/nowhere.yaml').successful is False
    assert node.settings.model_file == ''
    assert node.stage.estimator.model is before


def test_points_that_are_no_numbers_leave_the_rest_alone(ros: Any) -> None:
    graph = ros({'model': {}})
    node = graph.add('model')
    states = graph.hear(PointCloud2, 'model/state')
    particles = graph.talk(PointCloud2, 'particles')
    points = np.zeros(3, PARTICLE)
    points['id'] = [1, 2, 3]
    points['x'] = [1e-6, np.nan, np.inf]
    points['sigma'] = [1e-7, 1e-7, np.nan]
    for frame in range(5):
        particles.publish(messages.cloud(points, messages.to_stamp(1.0 + frame / 30)))
    graph.until(lambda: len(states) == 5)
    known = messages.points(states[-1], ESTIMATE)
    assert 1 in known['id']
    assert np.isfinite(known['x']).all()
    assert node.active


class Modelled:
    """A model node, and particles and fields for it."""

    def __init__(self, ros: Any, **parameters: Any) -> None:
        self.graph = ros({'model': parameters})
        self.node = self.graph.add('model')
        self.states = self.graph.hear(PointCloud2, 'model/state')
        self.particles = self.graph.talk(PointCloud2, 'particles')

    def see(self, t: float, theta: dict[int, float], frame: str = 'workspace') -> None:
        """Particles at rest, by their identities, with these headings."""
        points = np.zeros(len(theta), PARTICLE)
        points['id'], points['theta'] = list(theta), list(theta.values())
        points['x'], points['sigma'] = 1e-5 * points['id'], 1e-7
        message = messages.cloud(points, messages.to_stamp(t))
        message.header.frame_id = frame
        self.particles.publish(message)


def test_a_state_carries_the_headings_of_its_own_frame(ros: Any) -> None:
    """Whatever the order of the particles; not those of a frame in which they were not seen."""
    model = Modelled(ros)
    for t, theta in [(1.0, {7: 0.5, 2: -1.0}), (1.02, {2: -1.1, 7: math.nan}), (1.04, {7: 0.6})]:
        model.see(t, theta)
    model.graph.until(lambda: len(model.states) == 3)
    told = [{int(p['id']): p['theta'] for p in messages.estimates(state)}
            for state in model.states]
    assert told[0] == pytest.approx({7: 0.5, 2: -1.0})
    assert told[1] == pytest.approx({7: math.nan, 2: -1.1}, nan_ok=True)
    assert told[2] == pytest.approx({7: 0.6, 2: math.nan}, nan_ok=True)


def test_a_camera_that_is_gone_is_said_and_for_how_long(ros: Any) -> None:
    model = Modelled(ros)
    ahead = model.node.seconds() + 3600.0  # its clock is of no help
    model.see(ahead, {1: 0.0})
    model.graph.until(lambda: model.states)
    assert 'no particles' not in model.node.health()[1]
    model.graph.until(lambda: 'no particles' in model.node.health()[1])
    level, sentence, values = model.node.health()
    assert (level, sentence) == (b'\1', 'no particles for 1 s')
    assert values['silence_s'] == pytest.approx(1.0, abs=0.5)
    model.see(ahead + 1.0, {1: 0.0})
    model.graph.until(lambda: 'no particles' not in model.node.health()[1])


@pytest.mark.parametrize(('parameters', 'topic', 'kind'), [
    ({}, 'field/applied', MagneticField),
    ({'field_source': 'command'}, 'field/command', Vector3Stamped),
    ({'propulsion': 'rolling'}, 'field/rotating', TwistStamped),
    ({}, 'particles', PointCloud2)])
def test_what_is_in_another_frame_is_not_taken(
        ros: Any, parameters: dict[str, Any], topic: str, kind: type) -> None:
    model = Modelled(ros, **parameters)
    if topic == 'particles':
        model.see(1.0, {1: 0.0}, frame='camera')
    else:
        sent = model.graph.talk(kind, topic)
        message = kind()
        message.header.frame_id = 'camera'
        sent.publish(message)
    model.graph.until(lambda: "expected the frame 'workspace'; received 'camera'"
                      in model.node._complaint)
    assert not model.node.stage._early
    assert not model.states
