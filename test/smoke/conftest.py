"""One real graph for all smoke tests: a process for each node, the virtual rig and an emulator."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from domains import own_domain
from rig_file import write_rig

from microbot_ros.common.errors import RigError
from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.client.graph_client import GraphClient

NODES = ('recorder', 'tracker', 'model', 'controller', 'coil_driver', 'virtual_rig')
SPEEDS_UM_S, PHIS_RAD = (11.1, 13.2, 15.0), (-1.09, 3.82, 2.64)
"""Three times as fast as the paper's particles, so that they arrive soon."""
FAILSAFE_S = 100.0
"""After this a test gives up; a quiet machine needs a tenth of it."""


class SmokeRig:
    """A running graph in `folder`, and a client of it.

    No time of a node is short of half a second, so that a paused process does not end a run;
    where the gate trips all the same, `until` arms again.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.log, self.recording = folder / 'amplifier.jsonl', folder / 'recording'
        self.goal = np.zeros(2)
        self.began_s = time.time()
        self.said: list[str] = []
        self.estimates = np.empty(0)
        self.progress: dict[str, str] = {}
        self.health: dict[str, tuple[bytes, str]] = {}
        self.armed = self.driven = False
        self.graph = Graph(lambda who, line: self.said.append(f'{who}: {line}'))

    def start(self) -> None:
        """Start every process, and hear what the nodes publish."""
        port, file = self.folder / 'amplifier', self.folder / 'rig.yaml'
        nodes: dict[str, dict[str, Any]] = {
            'virtual_rig': {'amplifier_log': str(self.log), 'frame_rate_hz': 20.0,
                            'speeds_um_s': list(SPEEDS_UM_S), 'phis_rad': list(PHIS_RAD)},
            'tracker': {'pixel_size_um': 0.45},
            'model': {'radius_um': 2.3, 'viscosity_mPa_s': 1.245},
            'controller': {'deadline_ms': 1000.0, 'pose_timeout_ms': 5000.0,
                           'open_loop.directions_deg': [0.0, 120.0, 240.0, 60.0, 180.0, 300.0],
                           'open_loop.durations_s': [0.5] * 6, 'open_loop.repeat': True},
            'coil_driver': {'port': str(port), 'full_scale_A': 2.0, 'command_timeout_ms': 2000.0,
                            'max_command_age_ms': 2000.0, 'settling_ms': 2000.0,
                            'feedback_timeout_ms': 5000.0, 'idle_disarm_s': 60.0},
            'recorder': {'folder': str(self.recording), 'frame_every': 5, 'title': 'smoke'}}
        write_rig(file, nodes)
        self.graph.start('amplifier', [
            sys.executable, '-m', 'microbot_ros.cli', 'emulate', 'serial_transfer', '--link',
            str(port), '--log', str(self.log), '--full-scale-A', '2'], says_when_ready='serving')
        # The particles swim as soon as the virtual rig runs: all others are there by then.
        for names in (), NODES[:-1], NODES[-1:]:
            for name in names:
                self.graph.start_node(name, file)
            self.graph.wait_ready()
        self.client = GraphClient('smoke')
        self.client.watch_estimates(lambda points: setattr(self, 'estimates', points))
        self.client.watch_progress(lambda _, __, values: setattr(self, 'progress', values))
        self.client.watch_health(self._on_health)

    def _on_health(self, node: str, level: bytes, sentence: str, values: dict[str, str]) -> None:
        self.health[node] = level, sentence
        if node == 'coil_driver':
            self.armed = values['armed'] == 'True'

    def until(self, true: Callable[[], Any]) -> None:
        """Let the rig run until something is true; fail if it does not become so.

        While the rig is `driven` the gate is armed again where it has tripped.
        """
        deadline = time.monotonic() + FAILSAFE_S
        while not true():
            assert time.monotonic() < deadline, '\n'.join([*self.said[-20:], str(self.health)])
            assert not self.graph.ended(), self.said
            self.client.spin(0.05)
            self.graph.pump(0.0)
            if self.driven and not self.armed:
                self._arm()

    def drive(self, controller: str) -> None:
        """Let a controller drive: from rest, as the gate demands, with the gate armed."""
        self.client.set('controller', controller='hold')
        self.driven = True
        self.until(lambda: self.armed and self.health['coil_driver'][1].startswith('driving'))
        self.client.set('controller', controller=controller)
        self.until(lambda: self.progress.get('controller') == controller)

    def _arm(self) -> None:
        """Arm the gate, which waits for a command of zero then."""
        name = self.progress.get('controller', 'hold')
        self.client.set('controller', controller='hold')
        try:
            self.client.arm()
        except RigError as refused:  # a pulse of the check came late: again
            self.said.append(str(refused))
            return
        self.armed = True
        self.client.spin(0.3)
        self.client.set('controller', controller=name)

    def rest(self) -> None:
        """Let nothing drive any more, and nothing flow."""
        self.driven = False
        self.client.set('controller', controller='hold')
        self.client.stop()
        self.until(lambda: self.zero)

    def learn(self) -> None:
        """Drive in fixed directions until v and φ of every particle are known."""
        if not self._known():
            self.drive('open_loop')
            self.until(self._known)

    def _known(self) -> bool:
        found = self.estimates
        return len(found) == len(SPEEDS_UM_S) and bool(
            (found['speed_std'] < 1e-6).all() and (found['phi_std'] < 0.1).all())

    def entries(self) -> list[dict[str, Any]]:
        """Return what the amplifier's log holds so far."""
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    @property
    def zero(self) -> bool:
        """Whether nothing flows."""
        return not any(self.entries()[-1]['currents_A'])

    def microbot(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Run a command beside the rig, again where the rig was too busy to answer in time."""
        for _ in range(4):
            process = subprocess.Popen(
                [sys.executable, '-m', 'microbot_ros.cli', *map(str, words)],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            self.until(lambda process=process: process.poll() is not None)
            done = subprocess.CompletedProcess(
                words, process.returncode, *process.communicate())
            if ' within ' not in done.stderr:
                break
        return done

    def end(self) -> None:
        """Leave nothing running."""
        if hasattr(self, 'client'):
            self.client.__exit__()
        self.graph.__exit__()


@pytest.fixture(scope='module')
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SmokeRig]:
    """The graph, in a domain of its own; one file has all tests of it."""
    before = os.environ['ROS_DOMAIN_ID']
    os.environ['ROS_DOMAIN_ID'] = str(own_domain())
    made = SmokeRig(tmp_path_factory.mktemp('smoke'))
    try:
        made.start()
        yield made
    finally:
        made.end()
        os.environ['ROS_DOMAIN_ID'] = before
