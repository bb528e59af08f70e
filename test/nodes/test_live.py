"""Looking at a graph while it runs: what was collected is what was played."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from microbot_ros.nodes.collector import Collector
from microbot_ros.nodes.graph import Graph
from microbot_ros.nodes.remote import Remote
from microbot_ros.records import Commands, Conditions, Session, Tracks
from microbot_ros.session import write_session

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]


@pytest.fixture
def parameters(tmp_path: Path) -> Path:
    """A session of 20 s with a drift of 1 µm/s, and a graph that plays it in a loop."""
    rng = np.random.default_rng(5)
    t = np.arange(600) / 30
    angle = rng.uniform(-np.pi, np.pi, 14)[np.minimum(t // 1.5, 13).astype(int)]
    swim = 4e-6 / 30 * np.exp(1j * (angle + 0.7)) + 1e-6 / 30
    walk = rng.normal(0, np.sqrt(2 * 0.05e-12 / 30), (2, 600))
    path = np.cumsum(swim + walk[0] + 1j * walk[1])
    path = path + rng.normal(0, 3e-8, 600) + 1j * rng.normal(0, 3e-8, 600)
    tracks = Tracks(t, np.zeros(600, int), np.stack([path.real, path.imag], axis=1),
                    np.full(600, np.nan), np.full(600, 3e-8))
    commands = Commands(t - 1 / 30, 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    write_session(tmp_path / 'session', Session(tracks, commands, Conditions()))
    file = tmp_path / 'graph.yaml'
    file.write_text(yaml.safe_dump({
        'model': {'ros__parameters': {'radius_um': 2.0}},
        'player': {'ros__parameters': {'session': str(tmp_path / 'session'), 'rate': 4.0}}}))
    return file


def test_the_recent_past_becomes_a_session(parameters: Path) -> None:
    with Graph(lambda *_: None) as graph, Remote('test') as remote:
        collector = Collector(remote, 10.0)
        for node in ('model', 'player'):
            graph.start_nodes([node], parameters)
        for _ in range(600):
            remote.spin(0.1)
            if collector.span > 9.9:
                break
        session = collector.session()
    assert 9.9 < session.tracks.t[-1] <= 10.0
    assert np.diff(session.tracks.t).max() < 0.1
    assert session.conditions.radius == pytest.approx(2e-6)
    assert session.commands.t[0] <= session.tracks.t[0] + 0.1
    assert np.hypot(*session.commands.field.T) == pytest.approx(5e-3)


def test_discover_watches_and_proposes(parameters: Path, tmp_path: Path) -> None:
    with Graph(lambda *_: None) as graph:
        for node in ('model', 'player'):
            graph.start_nodes([node], parameters)
        done = subprocess.run(
            [sys.executable, '-m', 'microbot_ros.cli', 'discover', '--live', '--seconds', '14',
             '--rounds', '1', '--out', str(tmp_path / 'live')],
            capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    assert 'uniform_drift' in done.stdout
    assert (tmp_path / 'live' / 'model.yaml').is_file()
    assert (tmp_path / 'live' / 'report.html').is_file()
