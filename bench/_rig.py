"""How soon a rig answers: the processes of `microbot run`, a film, an emulated amplifier."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import yaml
from builtin_interfaces.msg import Time
from sensor_msgs.msg import Image, JointState, TimeReference
from visualization_msgs.msg import MarkerArray

from bench._emulator import FULL_SCALE_A, EmulatorProcess
from microbot_ros.common.errors import RigError
from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.client.graph_client import GraphClient

_WARM_S, _LOOK_S = 5.0, 0.5
TURNING: dict[str, Any] = {'controller': 'open_loop', 'open_loop.durations_s': [0.5] * 4,
                           'open_loop.directions_deg': [0.0, 90.0, 180.0, 270.0],
                           'open_loop.repeat': True}
"""A controller that turns the field for ever."""


@dataclass
class Answers:
    """Seconds from a frame in memory until its currents were written, and acknowledged."""

    written_s: list[float] = field(default_factory=list)
    acknowledged_s: list[float] = field(default_factory=list)
    cuts: int = 0
    """How often the gate tripped and was armed again."""


def answers(film: list[np.ndarray], rate_hz: float, frames: int, *,
            recorder: bool = False, viewer: bool = False) -> Answers:
    """What so many `frames` of a `film` (each (H, W), uint8) give, played at `rate_hz`."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(215 + os.getpid() % 17))  # nobody else's graph
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with (EmulatorProcess(folder) as board,
              running(folder, film, board, rate_hz, **(
                  {'recorder': {'folder': str(folder / 'recording')}} if recorder else {})),
              GraphClient('bench') as client):
            return _heard(client, frames / rate_hz, viewer)


@contextmanager
def running(folder: Path, film: list[np.ndarray], board: EmulatorProcess, rate_hz: float,
            **more: dict[str, Any]) -> Iterator[None]:
    """The nodes of a rig whose camera plays a `film`, and whose coils turn, and `more`, with their
    parameters; the files are in `folder`."""
    for number, picture in enumerate(film):
        cv2.imwrite(str(folder / f'{number:04d}.bmp'), picture)
    nodes: dict[str, dict[str, Any]] = {
        'camera': {'source': str(folder / '*.bmp'), 'frame_rate_hz': rate_hz, 'loop': True},
        'tracker': {'pixel_size_um': 0.45}, 'model': {}, 'controller': TURNING,
        'coil_driver': {'port': str(board.url), 'full_scale_A': FULL_SCALE_A},
        **more}
    with graph(folder, nodes):
        yield


@contextmanager
def graph(folder: Path, nodes: dict[str, dict[str, Any]],
          instead: Mapping[str, str] = MappingProxyType({})) -> Iterator[None]:
    """The processes of these `nodes` with their parameters, from a file in `folder`.

    A node in `instead` is run by that module.
    """
    parameters = folder / 'parameters.yaml'
    parameters.write_text(yaml.safe_dump(
        {node: {'ros__parameters': values} for node, values in nodes.items()}))
    with Graph(lambda *_: None) as started:
        for node in nodes:
            if node in instead:
                started.start(node, [sys.executable, '-m', instead[node], '--ros-args',
                                     '--params-file', str(parameters)])
            else:
                started.start_node(node, parameters)
        started.wait_ready(120.0)
        yield


def _heard(client: GraphClient, seconds: float, viewer: bool) -> Answers:
    found = listen(client)
    if viewer:
        for kind, topic in ((Image, 'overlay/image_raw'), (MarkerArray, 'markers')):
            client.node.create_subscription(kind, topic, lambda _: None, 1)
    drive(client, found, _WARM_S)
    found.written_s.clear()
    found.acknowledged_s.clear()
    found.cuts = 0
    drive(client, found, seconds)
    return found


def listen(client: GraphClient) -> Answers:
    """What fills while the `client` is spun."""
    found = Answers()

    def written(message: JointState, info: dict[str, Any]) -> None:
        if any(message.effort):
            found.written_s.append(
                info['source_timestamp'] * 1e-9 - _seconds(message.header.stamp))

    def acknowledged(message: TimeReference) -> None:
        found.acknowledged_s.append(_seconds(message.header.stamp) - _seconds(message.time_ref))
    client.node.create_subscription(JointState, 'coils/applied', written, 200)
    client.node.create_subscription(TimeReference, 'coil_driver/latency', acknowledged, 200)
    return found


def drive(client: GraphClient, found: Answers, seconds: float) -> None:
    """Let currents flow for that long, armed again wherever a busy machine cut them."""
    with suppress(RigError):
        client.arm()
    while seconds > 0:
        before = len(found.written_s)
        client.spin(_LOOK_S)
        seconds -= _LOOK_S
        if len(found.written_s) == before:
            found.cuts += 1
            with suppress(RigError):
                client.arm()


def _seconds(stamp: Time) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)
