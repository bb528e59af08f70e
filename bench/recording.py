"""Recordings without a ROS graph: what writing, opening, crashing and playing cost."""

from __future__ import annotations

import math
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from bench.figure import Figure
from microbot_ros.common.records import Commands, Session, Tracks
from microbot_ros.session.mcap.bag import typestore
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Message, Recording
from microbot_ros.session.replay.as_messages import SessionMessages
from microbot_ros.session.replay.playback import Playback

GIGABYTE = 10**9
IMAGE = 'sensor_msgs/msg/Image'
VECTOR = 'geometry_msgs/msg/Vector3Stamped'
KILLS = 20
_TOPICS = 3


def figures() -> Iterator[Figure]:
    """All figures of recording and replay that need no graph."""
    with tempfile.TemporaryDirectory(prefix='bench-recording-') as name:
        folder = Path(name)
        yield from _writing(folder / 'writing')
        yield from _opening(folder / 'opening')
        yield from _crashing(folder / 'crashing')
        yield from _playing(folder / 'playing')


def _frames(width: int, height: int) -> list[bytes]:
    """A few serialised frames with the grain of a camera."""
    rng = np.random.default_rng(0)
    types = typestore().types
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](0, 0), 'camera')
    pictures = (rng.normal(200, 3, (8, height * width)).clip(0, 255)).astype(np.uint8)
    return [
        bytes(typestore().serialize_cdr(
            types[IMAGE](header, height, width, 'mono8', 0, width, picture), IMAGE))
        for picture in pictures
    ]


def _session(seconds: float, rate: float = 100.0) -> Session:
    """Four particles and a command per frame."""
    t = np.arange(int(seconds * rate)) / rate
    rng = np.random.default_rng(1)
    rows = np.repeat(t, 4)
    unknown = np.full(len(rows), np.nan)
    tracks = Tracks(rows, np.tile(np.arange(4), len(t)), rng.normal(0, 1e-4, (len(rows), 2)),
                    unknown, unknown)
    return Session(tracks, Commands(t, rng.normal(0, 1e-3, (len(t), 2))))


def _busy(seconds: float, frames: list[bytes]) -> Iterator[Message]:
    """A loop at 100 frames/s: the frame, its particles, its command."""
    for message in SessionMessages(_session(seconds)).messages():
        yield message
        if message.topic == '/particles':
            frame = frames[message.t_ns // 10_000_000 % len(frames)]
            yield Message('/camera/image_raw', IMAGE, message.t_ns, frame)


def _writing(folder: Path, seconds: float = 6.0) -> list[Figure]:
    """Share of a core that 1280×1024 at 100 frames/s takes, sent at its own pace."""
    messages = list(_busy(seconds, _frames(1280, 1024)))
    with RecordingWriter(folder) as writer:
        ours = _share(messages, lambda m: writer.write(*m))
        late = time.process_time()
    ours += (time.process_time() - late) / seconds
    status = writer.status()
    shutil.rmtree(folder)
    bag = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with bag:
        connections = {
            m.topic: bag.add_connection(m.topic, m.type, typestore=typestore())
            for m in {m.topic: m for m in messages}.values()
        }
        theirs = _share(messages, lambda m: bag.write(connections[m.topic], m.t_ns, m.data))
    shutil.rmtree(folder)
    lost = len(messages) - sum(status.counts.values())
    return [
        Figure(9, 'recording 1280×1024 at 100 Hz, without ROS', 100 * ours, '% of a core', '≤ 50',
               f'rosbags {100 * theirs:.0f} %', ours <= 0.5),
        Figure(9, 'messages lost while recording them', lost, '', '0',
               f'of {len(messages)}', lost == 0 and not status.dropped),
    ]


def _share(messages: list[Message], send) -> float:
    """CPU seconds per second of messages handed over when they are due."""
    began, spent = time.monotonic(), time.process_time()
    first, last = messages[0].t_ns, messages[-1].t_ns
    for message in messages:
        wait = began + (message.t_ns - first) / 1e9 - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        send(message)
    return (time.process_time() - spent) / ((last - first) / 1e9)


_OPEN = """
import resource, sys, time
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.mcap.from_recording import session_of
began = time.perf_counter()
with Recording(sys.argv[1]) as recording:
    opened = time.perf_counter() - began
    session = session_of(recording)
print(opened, time.perf_counter() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def _opening(folder: Path, size: int = 2 * GIGABYTE) -> list[Figure]:
    """Opening 2 GB of frames, and reading the session out of between them."""
    noise = np.random.default_rng(2).integers(0, 256, (8, 1280 * 1024), np.uint8)
    frames = [picture.tobytes() for picture in noise]
    size = min(size, shutil.disk_usage(folder.parent).free // 3)
    seconds = size / len(frames[0]) / 100
    with RecordingWriter(folder) as writer:
        for message in _busy(seconds, frames):
            while writer.status().queued_bytes > 100e6:
                time.sleep(0.01)
            writer.write(*message)
    size = writer.status().bytes_written
    program = [sys.executable, '-c', _OPEN, folder]
    result = subprocess.run(program, capture_output=True, text=True, check=True)
    opened, read, memory = map(float, result.stdout.split())
    began = time.perf_counter()
    with AnyReader([folder]):
        theirs = time.perf_counter() - began
    # The index of a crashed recording has to be made from the data.
    (folder / 'metadata.yaml').unlink()
    file = next(folder.glob('*.mcap'))
    with file.open('r+b') as stream:
        stream.truncate(size - 1000)
    began = time.perf_counter()
    with Recording(folder) as recording:
        crashed = time.perf_counter() - began
        assert not recording.complete
    shutil.rmtree(folder)
    name = f'a recording of {size / GIGABYTE:.1f} GB'
    return [
        Figure(9, f'opening {name}', opened, 's', '≤ 2', f'rosbags {theirs:.2g} s', opened <= 2),
        Figure(9, f'opening {name} and reading its session', read, 's', '≤ 2', '', read <= 2),
        Figure(9, f'memory for {name}', memory / 1024, 'MB', '≤ 300', '', memory / 1024 <= 300),
        Figure(9, f'opening {name}, cut off', crashed, 's', '≤ 2', 'rosbags refuses',
               crashed <= 2),
    ]


_ENDLESS = """
import sys, time
from bench.recording import VECTOR, _busy, _frames
from microbot_ros.session.mcap.recorder import RecordingWriter
messages = list(_busy(1.0, _frames(640, 480)))
writer = RecordingWriter(sys.argv[1])
print('ready', flush=True)
while True:
    for message in messages:
        now = time.time_ns()
        writer.write(message.topic, message.type, now, message.data)
        print(now, flush=True)
        if message.topic == '/particles':
            time.sleep(0.01)
"""


def _crashing(folder: Path, at_once: int = 2) -> list[Figure]:
    """kill −9 at random moments: how far back the topic that lost most ends."""
    moments = random.Random(3)
    losses, readable = [], 0
    for batch in range(0, KILLS, at_once):
        paths = [folder / str(batch + i) for i in range(at_once)]
        for path, process in [(path, _start(path)) for path in paths]:
            process.stdout.readline()
            time.sleep(moments.uniform(0.2, 1.5) / at_once)
            process.send_signal(signal.SIGKILL)
            # The last line may be cut; a process killed at once has sent nothing.
            sent = process.communicate()[0].splitlines()[:-1] or ['0']
            with Recording(path) as recording:
                readable += 1
                last = [int(recording.times(topic)[-1]) for topic in recording.topics
                        if recording.topics[topic].count]
                kept = min(last) if len(last) == _TOPICS else int(sent[0])
                losses.append((int(sent[-1]) - kept) / 1e9)
            shutil.rmtree(path)
    return [
        Figure(9, f'readable after kill −9 at {KILLS} random moments', readable, '', str(KILLS),
               'rosbags refuses', readable == KILLS),
        Figure(9, 'longest loss by kill −9', max(losses), 's', '≤ 1', '', max(losses) <= 1),
    ]


def _start(path: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, '-c', _ENDLESS, path], stdout=subprocess.PIPE, text=True)


def _playing(folder: Path, seconds: float = 60.0) -> list[Figure]:
    """Times real time at which a recording of the small topics can be handed out."""
    with RecordingWriter(folder) as writer:
        for message in SessionMessages(_session(seconds)).messages():
            writer.write(*message)
    began = time.perf_counter()
    with Recording(folder) as recording:
        playback = Playback(recording, 0.0, rate=math.inf)
        count = sum(1 for _ in iter(lambda: playback.take(0.0), None))
    ours = seconds / (time.perf_counter() - began)
    began = time.perf_counter()
    with AnyReader([folder]) as reader:
        assert sum(1 for _ in reader.messages()) == count
    theirs = seconds / (time.perf_counter() - began)
    return [Figure(9, 'replay of small topics, without ROS', ours, '× real time', '≥ 20',
                   f'rosbags {theirs:.0f} ×', ours >= 20)]
