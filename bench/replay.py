"""Recording and replay with ROS and all: what a full load costs, and that replays agree."""

from __future__ import annotations

import math
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import yaml
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, PointCloud2, TimeReference

from bench._camera_load import PIXEL_SIZE_UM
from bench.figure import Figure, sized
from bench.recording import _session
from microbot_ros.common.errors import InputError
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import IMAGES_OUT, RELIABLE
from microbot_ros.nodes.base.topics import KEPT
from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.nodes.replay import Replay, plan_replay, recorded_parameters
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.replay.as_messages import SessionMessages
from microbot_ros.session.replay.compare import compare
from microbot_ros.session.replay.log import header_stamp_ns

RATE_HZ, SECONDS = 100, 60
WARM_SECONDS = 10
"""In which the tracker learns what particles look like."""
SETTLE_SECONDS = 3.0
"""After somebody has come or gone."""
KILLS = sized(20, 5)
ASKED = 25
STEERING = Path(__file__).parents[1] / 'test' / 'data' / 'steering.mcap'


def figures() -> Iterator[Figure]:
    """The load of 1280×1024 at 100 Hz, kill −9, replay at full speed, two replays of a run."""
    with tempfile.TemporaryDirectory(prefix='bench-replay-') as name:
        for measure in (_loading, _killing, _replaying, _agreeing):
            try:
                yield from measure(Path(name))
            except (InputError, RuntimeError, LookupError) as error:
                yield Figure(9, f'{measure.__name__[1:]}: {error!r}', math.nan, '', 'measured',
                             '', False)


def _loading(folder: Path) -> list[Figure]:
    """The closed loop over an emulated amplifier: without a recorder, with one, without."""
    (folder / 'load').mkdir()
    with Graph(lambda *_: None) as graph, GraphClient('bench') as client:
        nodes = _start(graph, folder / 'load')
        late: list[tuple[float, float]] = []

        def heard(message: TimeReference) -> None:
            spent = (messages.to_seconds(message.header.stamp)
                     - messages.to_seconds(message.time_ref))
            late.append((time.monotonic(), 1e3 * spent))

        client.node.create_subscription(TimeReference, 'coil_driver/latency', heard, 200)
        _listen(graph, client, WARM_SECONDS)
        client.set('controller', **{'open_loop.repeat': True})
        client.arm()
        client.set('controller', controller='open_loop')
        before = _latencies(graph, client, late, SECONDS / 2)
        graph.start_node('recorder', folder / 'load' / 'rig.yaml')
        graph.wait_ready(60.0)
        process = psutil.Process(graph.process_id('recorder'))
        begin, busy = time.monotonic(), sum(process.cpu_times()[:2])
        during = _latencies(graph, client, late, SECONDS)
        share = (sum(process.cpu_times()[:2]) - busy) / (time.monotonic() - begin)
        graph.stop(['recorder'])
        without = np.concatenate([before, _latencies(graph, client, late, SECONDS / 2)])
        graph.stop([*reversed(nodes)])
    return _judged(folder / 'load' / 'recording', share, without, during)


def _latencies(graph: Graph, client: GraphClient, late: list[tuple[float, float]], seconds: float,
               ) -> np.ndarray:
    """Exposure to acknowledgement [ms] of what is exposed from now on, once all has settled."""
    _listen(graph, client, SETTLE_SECONDS)
    begin = time.monotonic()
    _listen(graph, client, seconds)
    return np.array([latency for t, latency in late if t > begin])


def _judged(recording: Path, share: float, without: np.ndarray, during: np.ndarray,
            ) -> list[Figure]:
    lost, frames, count = _lost(recording)
    (p50, p99), (p50_without, p99_without) = (
        np.percentile(x, [50, 99]) for x in (during, without))
    ratio = float(p99 / p99_without)
    answered = len(during) / SECONDS
    what = f'recording 1280×1024 at {RATE_HZ} Hz and all topics, {SECONDS} s'
    return [
        Figure(9, f'{what}: frames and messages lost', lost, '', '0',
               f'of {frames} frames, {count} messages', lost == 0),
        Figure(9, f'{what}: recorder', 100 * share, '% of a core', '≤ 50', '', share <= 0.5),
        Figure(9, f'{what}: p99 of the loop against that without', ratio, '×', '≤ 1.2',
               f'{p99_without:.1f} ms without, p50 {p50_without:.1f} → {p50:.1f} ms, '
               f'{answered:.0f} commands a second acknowledged', ratio <= 1.2),
    ]


def _lost(path: Path) -> tuple[int, int, int]:
    """Frames and messages that are not in a recording, frames sent meanwhile, messages in it."""
    topics = ('/camera/image_raw', '/particles', '/model/state', '/field/command')
    with Recording(path) as recording:
        stamps = [{header_stamp_ns(m.data) for m in recording.messages([topic])}
                  for topic in topics]
        count = sum(topic.count for topic in recording.topics.values())
        dropped = sum(map(int, recording.metadata().get('dropped', {}).values()))
    first, last = min(stamps[0]), max(stamps[0])
    sent = round((last - first) * RATE_HZ / 1e9) + 1
    # Whoever answered a frame had it; the frames at the ends may lack one or the other.
    answered = [{t for t in those if first + 1e9 < t < last - 1e9} for those in stamps]
    unseen = sum(len(later - earlier) for earlier, later in pairwise(answered))
    return sent - len(stamps[0]) + unseen + dropped, sent, count


def _start(graph: Graph, folder: Path) -> list[str]:
    """The amplifier, the loop and its camera; their names."""
    port, rig = folder / 'amplifier', folder / 'rig.yaml'
    own: dict[str, dict[str, Any]] = {
        'tracker': {'pixel_size_um': PIXEL_SIZE_UM}, 'model': {'radius_um': 2.3},
        'controller': {'workspace_um': [-290.0, -230.0, 290.0, 230.0]},
        'coil_driver': {'port': str(port), 'command_timeout_ms': 500.0,
                        'max_command_age_ms': 500.0}}
    both = {**own, 'recorder': {'folder': str(folder / 'recording')}}
    rig.write_text(yaml.safe_dump({k: {'ros__parameters': v} for k, v in both.items()}))
    graph.start('amplifier', [
        sys.executable, '-m', 'microbot_ros.cli', 'emulate', 'serial_transfer', '--link',
        str(port), '--full-scale-A', '2'], says_when_ready='serving')
    graph.wait_ready(20.0)
    for node in own:
        graph.start_node(node, rig)
    graph.wait_ready(120.0)
    graph.start('camera', [
        sys.executable, '-m', 'bench._camera_load', '1280', '1024', str(RATE_HZ)])
    graph.wait_ready(60.0)
    return ['amplifier', *own, 'camera']


def _listen(graph: Graph, client: GraphClient, seconds: float) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        client.spin(min(0.5, left))
        graph.pump(0.0)


def _replaying(folder: Path, seconds: float = 120.0) -> list[Figure]:
    """Particles and commands at 100 Hz through the player to somebody who listens."""
    session = _session(seconds)
    with RecordingWriter(folder / 'small') as writer:
        for message in SessionMessages(session).messages():
            writer.write(*message)
    sent = len(np.unique(session.tracks.t))
    times, lost = _played(folder / 'small', 0, KEPT, sent)
    paced, lost_paced = _played(folder / 'small', ASKED, RELIABLE, sent)
    return [
        Figure(9, 'replay of small topics through ROS, as fast as it goes', times,
               '× real time', '≥ 20', '', times >= 20),
        Figure(9, 'messages lost in it by a listener that keeps all', lost, '', '0',
               f'of {sent}', lost == 0),
        Figure(9, f'replay of small topics through ROS, asked for {ASKED} ×', paced,
               '× real time', '≥ 20', '', paced >= 20),
        Figure(9, f'messages lost in it by a listener that keeps the last {RELIABLE.depth}',
               lost_paced, '', '0', f'of {sent}', lost_paced == 0)]


def _played(session: Path, rate: float, qos: QoSProfile, sent: int) -> tuple[float, int]:
    """Times real time at which particles at 100 Hz arrived, and how many did not."""
    heard: list[tuple[float, int]] = []
    with GraphClient('bench') as client, Graph(lambda *_: None) as graph:
        client.node.create_subscription(PointCloud2, 'particles', lambda data: heard.append(
            (time.monotonic(), header_stamp_ns(data))), qos, raw=True)
        graph.start('player', [sys.executable, '-m', 'microbot_ros.cli', 'replay', str(session),
                               '--rate', str(rate)])
        while not graph.ended():
            client.spin(0.05)
            graph.pump(0.0)
        client.spin(0.5)
    if len(heard) < 2:
        return 0.0, sent - len(heard)
    (begin, first), (end, last) = heard[0], heard[-1]
    return (last - first) / 1e9 / (end - begin), sent - len(heard)


def _killing(folder: Path) -> list[Figure]:
    """kill −9 of the recorder at random moments: how far back the topic that lost most ends."""
    moments = random.Random(5)
    losses = [_killed(folder / f'killed_{k}', moments.uniform(0.3, 3.0)) for k in range(KILLS)]
    return [Figure(9, f'longest loss by kill −9 of the recorder at {KILLS} random moments',
                   max(losses), 's', '≤ 1', 'rosbags refuses', max(losses) <= 1)]


def _killed(path: Path, seconds: float) -> float:
    """Seconds lost of frames or particles at 100 Hz by a recorder killed after so many."""
    rig = path.with_suffix('.yaml')
    rig.write_text(yaml.safe_dump({'recorder': {'ros__parameters': {'folder': str(path)}}}))
    noise = np.random.default_rng(6).integers(0, 256, (480, 640), np.uint8)
    with GraphClient('bench') as client, Graph(lambda *_: None) as graph:
        frames = client.node.create_publisher(Image, 'camera/image_raw', IMAGES_OUT)
        particles = client.node.create_publisher(PointCloud2, 'particles', RELIABLE)
        graph.start_node('recorder', rig)
        graph.wait_ready(60.0)
        while not (frames.get_subscription_count() and particles.get_subscription_count()):
            client.spin(0.01)
        began = time.time_ns()
        while (now := time.time_ns()) < began + seconds * 1e9:
            frames.publish(messages.image(noise, messages.to_stamp(now / 1e9)))
            particles.publish(messages.cloud(
                np.zeros(4, PARTICLE), messages.to_stamp(now / 1e9)))
            client.spin(0.01)
        os.kill(graph.process_id('recorder'), signal.SIGKILL)
    with Recording(path) as recording:
        last = [max(recording.times(topic), default=began) if topic in recording.topics else began
                for topic in ('/camera/image_raw', '/particles')]
    return float(now - min(last)) / 1e9


def _agreeing(folder: Path) -> list[Figure]:
    """Two replays of a run of the demo through model, controller and coil driver."""
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    with Recording(STEERING) as source:
        plan = plan_replay(source, STEERING)
        parameters = recorded_parameters(source, plan.nodes, folder)
        length = (source.end_ns - source.start_ns) / 1e9
    began = time.monotonic()
    for name in ('first', 'second'):
        Replay(STEERING, folder / name, plan, parameters).run()
    speed = 2 * length / (time.monotonic() - began)
    with Recording(folder / 'first') as a, Recording(folder / 'second') as b:
        found = compare(a, b, [topic for topics in plan.answers.values() for topic in topics
                               if topic in a.topics])
    pairs = sum(topic.pairs for topic in found)
    unequal = sum(topic.unequal + topic.only_a + topic.only_b for topic in found)
    return [
        Figure(9, 'two replays of a run: messages that differ', unequal, '', '0',
               f'of {pairs}; {speed:.1f} × real time, compilation included',
               unequal == 0 and pairs > 0)]
