"""Rollers that do not roll below some frequency, hidden in a rig of real nodes, are found."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rig_file import write_rig

from microbot_ros.cli.demo.robots import rolling
from microbot_ros.discovery.discover import discover
from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.session.mcap.from_recording import session_of
from microbot_ros.session.mcap.recording import open_recording

pytestmark = [pytest.mark.soak, pytest.mark.timeout(400)]

CUT_IN_HZ, SECONDS, LEG_S = 1.5, 36.0, 1.5
PATIENT = {'command_timeout_ms': 500.0, 'max_command_age_ms': 500.0}


@pytest.fixture
def emulator_options() -> dict[str, Any]:
    """A board of six coils."""
    return {'channels': 6}


def _there_and_back(file: Path) -> None:
    """Ways in all directions, and each of them back, below and above the cut-in."""
    rng = np.random.default_rng(5)
    legs = np.arange(0.0, SECONDS, LEG_S)
    direction = np.repeat(rng.uniform(-np.pi, np.pi, len(legs) // 2), 2)
    direction[1::2] += np.pi
    frequency = np.repeat(rng.choice([0.8, 1.2, 1.7, 2.2, 3.0, 4.0], len(legs) // 2), 2)
    np.savetxt(file, np.c_[legs, direction, frequency], delimiter=',', fmt='%.6f', comments='',
               header='t_s,direction_rad,frequency_hz')


def _rig(folder: Path, emulator: Any) -> Path:
    """The rolling demo's, with the effect in its virtual rig and the ways to play."""
    nodes: dict[str, dict[str, Any]] = rolling(folder).nodes
    _there_and_back(folder / 'commands.csv')
    nodes['virtual_rig'] |= {'amplifier_log': str(emulator.log), 'effect': 'drive_response',
                             'effect_parameters': [f'cut_in_hz={CUT_IN_HZ}']}
    nodes['tracker']['pixel_size_um'] = 0.45
    nodes['model'] |= {'radius_um': 2.3, 'viscosity_mPa_s': 1.245}
    nodes['controller'] |= {'controller': 'hold', 'deadline_ms': 100.0, 'open_loop.repeat': False,
                            'open_loop.file': str(folder / 'commands.csv')}
    nodes['coil_driver'] |= {'port': emulator.url, 'full_scale_A': 2.0} | PATIENT
    nodes['recorder'] = {'folder': str(folder / 'recording'), 'frame_every': 0}
    return write_rig(folder / 'rig.yaml', nodes)


# By the stamps of several processes: one that stands still for a moment is a step of its own.
def test_a_hidden_cut_in_is_named_and_the_gap_closes(tmp_path: Path, emulator: Any) -> None:
    with Graph(lambda *_: None) as graph, GraphClient('test') as client:
        file = _rig(tmp_path, emulator)
        for node in ('virtual_rig', 'tracker', 'model', 'controller', 'coil_driver', 'recorder'):
            graph.start_node(node, file)
        graph.wait_ready(300.0)
        seen: list[np.ndarray] = []
        client.watch_estimates(seen.append)
        assert client.until(lambda: seen and len(seen[-1]) == 4, 60.0)
        client.arm()
        client.set('controller', controller='open_loop')
        begun = time.monotonic()
        client.until(lambda: graph.ended() or time.monotonic() > begun + SECONDS, SECONDS + 10.0)
        assert not graph.ended()
    with open_recording(tmp_path / 'recording') as recording:
        session = session_of(recording)
    found = discover([session])
    named, = (effect for effect in found.effects if effect.status == 'established')
    assert named.id == 'drive_response'
    cut_in = named.parameters['cut_in_hz']
    assert abs(cut_in.value - CUT_IN_HZ) < 3 * cut_in.std
    assert found.gap.before > 0.4e-6
    assert found.gap.after < found.gap.before / 3
