"""Discovery that drives, over a real graph: a rig whose inside is not ours, and what may stop it.

The rig is one node that publishes `particles` and follows `field/applied`, with particles of the
fine physics in it. Everything else is as always: model, controller, coil driver, amplifier.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from nodes.foreign_rig import ForeignRig
from rig_file import write_rig

from microbot_ros.discovery.discover import discover
from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.session import read_session

pytestmark = [pytest.mark.soak, pytest.mark.timeout(400)]

class Stand:
    """The graph with a foreign rig, armed, and `microbot discover --drive` beside it."""

    def __init__(self, folder: Path, emulator: object, effect: str,
                 parameters: dict[str, float]) -> None:
        self.out = folder / 'driven'
        file = write_rig(folder / 'graph.yaml', {
            'model': {'radius_um': 2.3, 'viscosity_mPa_s': 1.245},
            'controller': {'deadline_ms': 100.0},
            'coil_driver': {'port': emulator.url, 'command_timeout_ms': 400.0,
                            'max_command_age_ms': 400.0}})
        self._graph = Graph(lambda *_: None)
        for node in ('model', 'controller', 'coil_driver'):
            self._graph.start_node(node, file)
        self._graph.wait_ready(60.0)
        self.client = GraphClient('test')
        self.rig = ForeignRig(self.client.node, effect, parameters)
        self._serving = threading.Event()
        self.client.spin(1.0)
        self.client.arm()

    def discover(self, *options: str) -> subprocess.Popen[str]:
        """Begin to drive."""
        return subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'discover', '--drive', '--out',
             str(self.out), *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def until(self, true: Callable[[], object], seconds: float = 60.0) -> None:
        """Let the rig live until something is true; fail if it does not become so."""
        assert self.client.until(true, seconds), 'did not happen in time'

    def ended(self, process: subprocess.Popen[str], seconds: float = 60.0) -> tuple[str, str]:
        """What it said, once it has ended."""
        self.until(lambda: process.poll() is not None, seconds)
        out, err = process.communicate()
        return out, err

    def result(self) -> dict:
        """What was written."""
        return json.loads((self.out / 'result.json').read_text())

    def end(self) -> None:
        """Leave nothing running."""
        self.client.__exit__()
        self._graph.__exit__()


@pytest.fixture
def stand(tmp_path: Path, emulator: object) -> Iterator[Callable[..., Stand]]:
    """Makes the graph; ends it afterwards."""
    made: list[Stand] = []

    def make(effect: str, parameters: dict[str, float]) -> Stand:
        made.append(Stand(tmp_path, emulator, effect, parameters))
        return made[-1]

    yield make
    for one in made:
        one.end()


# Its stand-in stamps poses by this machine's clock: a pause is a step that no effect explains.
def test_a_rig_that_is_not_ours_is_asked_until_it_is_settled(
        stand: Callable[..., Stand], emulator: object) -> None:
    here = stand('coil_gain_mismatch', {'gain_ratio': 1.25})
    process = here.discover('--minutes', '2', '--apply')
    out, err = here.ended(process, 330.0)
    assert process.returncode == 0, err
    found = here.result()
    assert found['decided'] == 'settled', (out, err)
    assert [(e['id'], e['status']) for e in found['effects']] == [
        ('coil_gain_mismatch', 'established')]
    ratio = found['effects'][0]['parameters']['gain_ratio']
    assert abs(ratio['value'] - 1.25) < 4 * ratio['std']
    played = found['experiments']
    assert played[-1]['odds']['coil_gain_mismatch'] > 0.98
    assert found['minutes'] < 2.2
    sessions = [read_session(here.out / one['session']) for one in played]
    again = discover(sessions[:4])
    assert 'coil_gain_mismatch' in [e.id for e in again.effects]
    here.until(lambda: emulator.zero, 10.0)
    with_model = {here.client.get(node, 'model_file')['model_file']
                  for node in ('model', 'controller')}
    assert with_model == {str(here.out / 'model.yaml')}
    assert 'held a particle' in (here.out / 'report.html').read_text()
