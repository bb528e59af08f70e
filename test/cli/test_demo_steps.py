"""The steps of `microbot demo`, with a rig and a clock that are played."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from microbot_ros.cli.demo import demo
from microbot_ros.cli.demo.robots import KINDS
from microbot_ros.common.errors import InputError
from microbot_ros.loop.points import ESTIMATE
from microbot_ros.nodes.client import graph_client


class Client:
    """Stands in for a client of the graph; its clock goes as it spins."""

    calls: list[tuple[str, Any]]
    now: float
    found: bool

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing runs."""

    def watch_estimates(self, tell: Any) -> None:
        self.tell = tell

    def watch_health(self, tell: Any) -> None:
        self.health = tell

    def spin(self, seconds: float) -> None:
        type(self).now += seconds
        points = np.zeros(2 * self.found, ESTIMATE)
        if self.found:
            points['id'], points['speed'], points['speed_std'] = [1, 2], 5e-6, 1e-7
        self.tell(points)
        self.health('coil_driver', b'\2', 'silent', {})

    def arm(self) -> None:
        self.calls.append(('arm',))

    def stop(self) -> None:
        self.calls.append(('stop',))

    def set(self, node: str, **values: Any) -> None:
        self.calls.append((node, values['controller']))

    def send_goals(self, goals: list[tuple[float, float]]) -> None:
        self.calls.append(('goals', len(goals)))


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> type[Client]:
    """The rig of one test."""
    kind = type('Client', (Client,), {'calls': [], 'now': 100.0, 'found': True})
    monkeypatch.setattr(graph_client, 'GraphClient', kind)
    monkeypatch.setattr(demo, 'time', SimpleNamespace(
        monotonic=lambda: kind.now, time=lambda: kind.now))
    return kind


GRAPH: Any = SimpleNamespace(pump=lambda _: None)


@pytest.mark.parametrize('robots', ['catalytic', 'rolling'])
def test_it_learns_goes_and_comes_to_rest_in_order(
        client: type[Client], tmp_path: Path, robots: str) -> None:
    kind = KINDS[robots](tmp_path)
    run = demo._steer(GRAPH, 30.0, kind, 0.0)
    assert client.calls == [
        ('arm',), ('controller', 'open_loop'), ('controller', kind.controller),
        ('goals', len(run.goals)), ('controller', 'hold'), ('stop',)]
    assert run.controllers == ['hold', 'open_loop', kind.controller, 'hold']
    assert run.faults == ['silent']
    assert 1 <= len(run.goals) <= 3
    assert client.now >= 130.0


def test_without_a_particle_it_says_so(client: type[Client], tmp_path: Path) -> None:
    client.found = False
    with pytest.raises(InputError, match='found no particle within 60 s'):
        demo._steer(GRAPH, 30.0, KINDS['catalytic'](tmp_path), 0.0)
    assert client.calls == []


def test_the_file_of_its_rig_is_that_of_any_rig(tmp_path: Path) -> None:
    from microbot_ros.nodes.configuration import read_rig

    for name, make in KINDS.items():
        file = tmp_path / f'{name}.yaml'
        log = tmp_path / 'amplifier.jsonl'
        log.touch()
        file.write_text(demo._rig_file(tmp_path, tmp_path / 'port', log, 3, make(tmp_path)))
        assert read_rig(file, '/').keys() == {*demo.NODES, 'cockpit'}
        assert yaml.safe_load(file.read_text())['virtual_rig']['ros__parameters']['seed'] == 3
