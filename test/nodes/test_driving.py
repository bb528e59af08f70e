"""A rig that discovery drives, in this process: what it plays, and what stops it."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from nodes.foreign_rig import FIELD, ForeignRig
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

from microbot_ros.common.errors import RigError
from microbot_ros.common.records import Session
from microbot_ros.discovery.driven.plan import Plan
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.nodes.client.driven_rig import DrivenRig
from microbot_ros.nodes.client.graph_client import GraphClient

# What is played lasts as long as on a rig, and some of it is stopped by signals.
pytestmark = pytest.mark.rig

# A process that is held up skips what it had no time for: each field lasts longer than that.
SHORT = Plan(np.array([0.0, 2.0, 4.0, 1.0]), np.full(4, FIELD), np.full(4, 1.0))
LONG = Plan(np.array([0.0, 2.0]), np.full(2, FIELD), np.full(2, 30.0))


class Stand:
    """Model, controller and coil driver beside a foreign rig, armed, and a client."""

    def __init__(self, ros: Any, emulator: Any) -> None:
        self.emulator = emulator
        self.graph = ros({
            'model': {'radius_um': 2.3, 'viscosity_mPa_s': 1.245},
            'coil_driver': {'port': emulator.url, 'idle_disarm_s': 60.0}})
        for name in ('model', 'controller', 'coil_driver'):
            assert self.graph.add(name).active
        self.rig = ForeignRig(self.graph.probe, 'coil_gain_mismatch', {'gain_ratio': 1.25})
        self.arm(True)
        self.graph.until(lambda: not self.driver.gate.holding)

    @property
    def driver(self) -> CoilDriver:
        """The driver of the coils."""
        driver: CoilDriver = self.graph.nodes['coil_driver']._driver
        return driver

    def arm(self, on: bool) -> None:
        """Arm or disarm."""
        self.graph.until(lambda: self.graph.call(
            SetBool, 'coil_driver/arm', SetBool.Request(data=on)).success)

    @property
    def controller(self) -> str:
        """The controller that drives."""
        name: str = self.graph.nodes['controller'].settings.controller
        return name

    def when_driven(self, do: Callable[[], None]) -> threading.Thread:
        """Do something in a thread once the field of the rig has changed a few times."""
        over = threading.Event()

        def act() -> None:
            while self.rig.field < 1e-3 and not over.wait(0.01):
                pass
            do()
        thread = threading.Thread(target=act, daemon=True)
        thread.start()
        return thread


@pytest.fixture
def stand(ros: Any, emulator: Any) -> Stand:
    """The rig of one test."""
    return Stand(ros, emulator)


@pytest.fixture
def client(stand: Stand) -> Iterator[GraphClient]:
    """A client of the rig, whose nodes are served meanwhile."""
    with stand.graph.spinning(), GraphClient('discover') as made:
        yield made


def test_a_plan_is_played_and_what_was_seen_is_kept(stand: Stand, client: GraphClient) -> None:
    kept: list[Session] = []
    with DrivenRig(client, kept.append) as rig:
        assert stand.controller == 'experiment'
        played = rig.play(SHORT)
    assert not played.stopped
    assert stand.controller == 'hold'
    session, = kept
    assert len(np.unique(session.tracks.particle)) == 4
    strength = np.hypot(*session.commands.field.T)
    assert strength.max() == pytest.approx(FIELD, rel=0.02)
    angle = np.arctan2(*session.commands.field[strength > 0.9 * FIELD].T[::-1])
    for wanted in SHORT.angle:
        assert np.abs(np.angle(np.exp(1j * (angle - wanted)))).min() < 0.05
    assert client.until(lambda: stand.emulator.zero, 30.0)


def _operator(_: Stand, __: DrivenRig) -> None:
    with GraphClient('operator') as client:
        client.set('controller', controller='open_loop')


def _disarmed(here: Stand, _: DrivenRig) -> None:
    here.driver.disarm()


def _gone(here: Stand, _: DrivenRig) -> None:
    here.rig.gone = True


def _dark(here: Stand, _: DrivenRig) -> None:
    here.rig.dark = True


def _silent(here: Stand, _: DrivenRig) -> None:
    here.graph.nodes['coil_driver']._diagnostics = SimpleNamespace(publish=lambda _: None)


def _told(_: Stand, rig: DrivenRig) -> None:
    rig.tell_to_end()


@pytest.mark.parametrize(('go_wrong', 'reason'), [
    (_operator, 'an operator let'), (_disarmed, 'the gate is disarmed'),
    (_gone, 'no particle has been seen'), (_dark, 'seen'),
    (_silent, 'the coil driver published nothing'), (_told, 'a stop was requested')])
def test_what_goes_wrong_stops_the_plan_and_leaves_the_rig_at_rest(
        stand: Stand, client: GraphClient, patience: Callable[..., None],
        go_wrong: Callable[..., None], reason: str) -> None:
    patience(unseen_s=1.5)
    kept: list[Session] = []
    with DrivenRig(client, kept.append) as rig:
        thread = stand.when_driven(lambda: go_wrong(stand, rig))
        played = rig.play(LONG)
        thread.join()
        assert reason in played.stopped or 'said nothing' in played.stopped
        again = rig.play(SHORT).stopped
        assert again.split('; zero')[0] == played.stopped.split('; zero')[0] or go_wrong in (
            _gone, _dark, _silent)
    assert stand.controller == ('open_loop' if go_wrong is _operator else 'hold')
    assert len(kept) >= 1
    if go_wrong is not _operator:
        assert client.until(lambda: stand.emulator.zero, 30.0)


def test_a_full_disk_stops_it(stand: Stand, client: GraphClient) -> None:
    def full(_: Session) -> None:
        raise OSError('no space left')
    with DrivenRig(client, full) as rig:
        assert 'could not be written (no space left)' in rig.play(SHORT).stopped
    assert client.until(lambda: stand.emulator.zero, 30.0)


def test_nothing_is_driven_without_an_armed_gate(stand: Stand) -> None:
    stand.arm(False)
    with stand.graph.spinning(), GraphClient('discover') as client, \
            pytest.raises(RigError, match='the gate is not armed'), DrivenRig(client, print):
        pass
    assert stand.controller == 'hold'
    assert stand.rig.field == 0


def test_nothing_is_driven_that_is_not_seen(
        stand: Stand, client: GraphClient, patience: Callable[..., None]) -> None:
    patience(state_s=3.0)
    stand.rig.gone = True
    with pytest.raises(RigError, match='no particle was seen for 3 s'), DrivenRig(client, print):
        pass


@pytest.mark.timeout(240)
def test_discovery_that_is_told_to_end_writes_down_what_it_has(
        stand: Stand, tmp_path: Path) -> None:
    out = tmp_path / 'driven'
    seen = stand.graph.hear(PointCloud2, 'particles')

    def end() -> None:
        enough = len(seen) + 150
        while len(seen) < enough:
            threading.Event().wait(0.05)
        os.kill(os.getpid(), signal.SIGTERM)
    thread = stand.when_driven(end)
    status, said, error = stand.graph.microbot(
        'discover', '--drive', '--minutes', '2', '--out', out)
    thread.join()
    assert status in (0, 1), error
    assert 'a stop was requested' in said + error
    found = json.loads((out / 'result.json').read_text())
    assert found['decided'] == 'stopped'
    assert found['minutes'] > 0
    assert (out / 'experiment-1' / 'tracks.csv').is_file()
    assert stand.controller == 'hold'
    stand.graph.until(lambda: stand.emulator.zero)
