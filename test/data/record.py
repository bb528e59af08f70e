"""Makes the recordings that `test_replay.py` replays through today's nodes.

    python test/data/record.py          # new runs
    python test/data/record.py again    # the same runs, answered by the nodes of today

Runs of a real graph, replayed once, so that they hold what the nodes of that day answered. Where
nodes are meant to answer otherwise, look at `microbot replay --check`, and then record again.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import yaml

from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.replay import Replay, plan_replay, recorded_parameters
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

HERE = Path(__file__).parent
PIXEL_SIZE_UM = 0.45
FRAMES = 150
BEFORE_NS = 4_000_000_000
STEERED = ['model', 'controller', 'coil_driver']


def steer(folder: Path) -> Path:
    """The demo: four particles swim, are learned, and one is steered."""
    subprocess.run([sys.executable, '-m', 'microbot_ros.cli', 'demo', '--seconds', '15', '--out',
                    folder / 'demo'], check=False)  # exit 1: a busy machine had the loop cut
    return folder / 'demo' / 'recording'


def track(folder: Path) -> Path:
    """Two particles in a small view, from a camera that plays pictures, through the tracker."""
    film = folder / 'film'
    film.mkdir()
    scope = Microscope(MicroscopeSettings(
        width_px=112, height_px=80, pixel_size_um=PIXEL_SIZE_UM, specks=2, smudges=2, drifting=1,
        defocus_px=0.2, electrons_per_level=400, read_noise=0.1), seed=3)
    start, swim = np.array([-14 + 6j, 12 - 8j]), np.array([4.0, 3.0]) * np.exp([0.3j, 2.2j])
    for frame in range(FRAMES):
        place = 1e-6 * (start + swim * frame / 30)
        picture = scope.render(np.stack([place.real, place.imag], 1), np.angle(swim), frame / 30)
        cv2.imwrite(str(film / f'{frame:03d}.png'), picture)
    recording, file = folder / 'live', folder / 'rig.yaml'
    file.write_text(yaml.safe_dump({node: {'ros__parameters': values} for node, values in {
        'camera': {'source': str(film), 'frame_rate_hz': 30.0},
        'tracker': {'pixel_size_um': PIXEL_SIZE_UM},
        'recorder': {'folder': str(recording),
                     'topics': ['camera/image_raw', 'particles', 'loop/log']},
    }.items()}))
    with Graph(lambda who, line: print(f'{who}: {line}')) as graph:
        for node in ('recorder', 'tracker', 'camera'):
            graph.start_node(node, file)
            graph.wait_ready(60.0)
        for _ in range(60):
            graph.pump(0.1)
        graph.stop(['recorder', 'tracker', 'camera'])
    return recording


def seconds_after_goals(recording: Path, seconds: float) -> float:
    """The time [s] of a recording that long after the goals."""
    with Recording(recording) as source:
        return float(source.times('/goals')[-1] - source.start_ns) / 1e9 + seconds


def from_first_frame(recording: Path, out: Path) -> Path:
    """Copy a recording without what came before its frames: a busy machine starts slowly."""
    with Recording(recording) as source, RecordingWriter(out) as writer:
        for name, content in source.attachments().items():
            writer.attach(name, content)
        first = int(source.times('/particles')[0])
        for message in source.messages(None, first - BEFORE_NS):
            # A line of the log holds up to 3 s of readings of the field.
            if message.topic != '/loop/log' or message.t_ns >= first:
                writer.write(*message)
    return out


def keep(recording: Path, name: str, nodes: list[str], end_s: float = 0.0) -> None:
    """What the nodes say to a recording, beside this file.

    A pass for each node: in each one more takes what those before it say today.
    """
    with tempfile.TemporaryDirectory() as folder:
        for node in nodes:
            out = Path(folder) / node / name
            with Recording(recording) as source:
                plan = plan_replay(source, recording, nodes)
                parameters = recorded_parameters(source, nodes, Path(folder))
                Replay(recording, out, plan, parameters, end_s).run()
            recording, end_s = out, 0.0
        shutil.copy(recording / f'{name}_0.mcap', HERE / f'{name}.mcap')


if __name__ == '__main__':
    os.environ.setdefault('ROS_DOMAIN_ID', '99')
    with tempfile.TemporaryDirectory() as scratch:
        if 'again' in sys.argv:
            keep(HERE / 'tracking.mcap', 'tracking', ['tracker'])
            keep(HERE / 'steering.mcap', 'steering', STEERED)
        else:
            keep(track(Path(scratch)), 'tracking', ['tracker'], 2.8)
            demo = from_first_frame(steer(Path(scratch)), Path(scratch) / 'trimmed')
            keep(demo, 'steering', STEERED, seconds_after_goals(demo, 2.5))
