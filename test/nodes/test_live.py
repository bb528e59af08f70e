"""Looking at a graph while it runs: what was collected is what was played."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from schemas import conforming
from std_msgs.msg import String

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.discovery.discover import discover
from microbot_ros.model.io.model_file import read_model
from microbot_ros.nodes.base.lifecycle import LATCHED
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.nodes.client.live_session_buffer import LiveSessionBuffer
from microbot_ros.nodes.client.verdict_publisher import VerdictPublisher
from microbot_ros.session import write_session

FREQUENCIES = np.array([1.0, 2.0, 4.0])


def _film(rolling: bool) -> Session:
    """20 s of one particle that turns every 1.5 s, carried along at 1 µm/s."""
    rng = np.random.default_rng(5)
    t = np.arange(600) / 30
    leg = np.minimum(t // 1.5, 13).astype(int)
    angle = rng.uniform(-np.pi, np.pi, 14)[leg]
    frequency = rng.choice(FREQUENCIES, 14)[leg] if rolling else None
    speed = 4e-6 if frequency is None else 2e-6 * frequency
    swim = speed / 30 * np.exp(1j * (angle + 0.7)) + 1e-6 / 30
    walk = rng.normal(0, np.sqrt(2 * 0.05e-12 / 30), (2, 600))
    path = np.cumsum(swim + walk[0] + 1j * walk[1])
    path = path + rng.normal(0, 3e-8, 600) + 1j * rng.normal(0, 3e-8, 600)
    tracks = Tracks(t, np.zeros(600, int), np.stack([path.real, path.imag], axis=1),
                    np.full(600, np.nan), np.full(600, 3e-8))
    field = 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Session(tracks, Commands(t - 1 / 30, field, frequency),
                   Conditions('rolling' if rolling else 'catalytic'))


def _graph(ros: Any, folder: Path, rolling: bool, *more: str) -> Any:
    """A graph in which the film, five times as fast, stands for a rig that is live."""
    write_session(folder / 'session', _film(rolling))
    graph = ros({
        'model': {'radius_um': 2.0, 'propulsion': 'rolling' if rolling else 'catalytic'},
        'player': {'session': str(folder / 'session'), 'rate': 5.0, 'into_live_rig': True}})
    for name in ('model', *more):
        assert graph.add(name).active
    return graph


@pytest.mark.rig
@pytest.mark.parametrize('rolling', [False, True])
def test_the_recent_past_becomes_a_session(ros: Any, tmp_path: Path, rolling: bool) -> None:
    graph = _graph(ros, tmp_path, rolling)
    with GraphClient('test') as client, graph.spinning():
        recent = LiveSessionBuffer(client, 10.0)
        graph.add('player')
        assert client.until(lambda: recent.span > 9.9, 60.0)
        session = recent.session()
    assert 9.9 < session.tracks.t[-1] <= 10.0
    assert np.diff(session.tracks.t).max() < 0.1
    assert session.conditions.radius == pytest.approx(2e-6)
    assert session.commands.t[0] <= session.tracks.t[0] + 0.1
    assert np.hypot(*session.commands.field.T) == pytest.approx(5e-3)
    if rolling:
        assert session.conditions.propulsion == 'rolling'
        nearest = np.abs(session.commands.frequency[:, None] - FREQUENCIES).min(axis=1)
        assert nearest.max() < 1e-6
    assert [effect.id for effect in discover([session]).effects] == ['uniform_drift']


@pytest.mark.rig
def test_what_waited_during_a_look_is_not_looked_at_again(ros: Any, tmp_path: Path) -> None:
    graph = _graph(ros, tmp_path, False)
    with GraphClient('test') as client, graph.spinning():
        recent = LiveSessionBuffer(client, 10.0)
        graph.add('player')
        assert client.until(lambda: recent.span > 2.0, 60.0)
        last = recent.session().tracks
        recent.forget()
        assert recent.span == 0.0
        assert client.until(lambda: recent.span > 1.0, 60.0)
        session = recent.session()
    assert last.t[-1] > 2.0
    assert session.commands.t[0] <= session.tracks.t[0] + 0.1
    assert not (session.tracks.position[:1] == last.position).all(axis=1).any()


def test_a_screen_that_comes_later_hears_the_last_verdict() -> None:
    result = {'verdict': 'named', 'effects': [{'id': 'uniform_drift'}], 'gap': {'before_um': 1.0}}
    heard: list[str] = []
    with GraphClient('test') as client:
        verdict = VerdictPublisher(client)
        verdict.publish({'verdict': 'consistent'})
        verdict.publish(result)
        client.node.create_subscription(
            String, 'discovery/verdict', lambda message: heard.append(message.data), LATCHED)
        assert client.until(lambda: heard, 20.0)
        with pytest.raises(ValueError, match='not JSON compliant'):
            verdict.publish({'gap': float('nan')})
    assert [json.loads(line) for line in heard] == [result]
    assert '\n' not in heard[0]


@pytest.mark.rig
def test_discover_watches_and_what_it_proposes_is_used_while_running(
        ros: Any, tmp_path: Path) -> None:
    graph = _graph(ros, tmp_path, False, 'controller')
    heard = graph.hear(String, 'discovery/verdict', LATCHED)
    graph.add('player')
    status, out, error = graph.microbot(
        'discover', '--live', '--seconds', '14', '--rounds', '1', '--out', tmp_path / 'live')
    assert status == 0, error
    assert 'uniform_drift' in out
    graph.until(lambda: heard)
    conforming('discovery/verdict', heard[0].data)
    proposed = re.findall(r'to use it: microbot (.*)', error)
    assert len(proposed) == 2
    for line in proposed:
        status, _, error = graph.microbot(*line.split())
        assert status == 0, error
    files = {graph.nodes[node].settings.model_file for node in ('model', 'controller')}
    assert files == {str(tmp_path / 'live' / 'look-1' / 'model.yaml')}
    assert read_model(files.pop())[0].effect('uniform_drift') is not None
    assert (tmp_path / 'live' / 'look-1' / 'report.html').is_file()
    written = json.loads((tmp_path / 'live' / 'look-1' / 'result.json').read_text())
    assert [json.loads(one.data) for one in heard] == [written]
