"""The demo, whole: its numbers, its files, and another reader's view of its recording."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
import psutil
import pytest
from command_line import microbot
from stolen import Processors

from microbot_ros.cli.demo.demo import GOALS_UM, places_within, tell_shortcomings
from microbot_ros.cli.demo.results import goals_reached

pytestmark = pytest.mark.timeout(600)


def watchdogs(out: Path) -> int:
    """How often the amplifier had to end the currents by itself."""
    entries = [json.loads(line) for line in (out / 'amplifier.jsonl').read_text().splitlines()]
    return [entry['cause'] for entry in entries].count('watchdog')


def _demo(folder: Path, *options: str) -> Path:
    """What a demo leaves behind: the first that had this machine to itself."""
    for number in range(4):
        out = folder / f'demo_{number}'
        with Processors() as processors:
            done = subprocess.run(
                [sys.executable, '-m', 'microbot_ros.cli', 'demo', '--out', str(out), *options],
                capture_output=True, text=True, timeout=250)
        if processors.ours or (done.returncode == 0 and watchdogs(out) == 1):
            break
    assert done.returncode == 0, f'{processors}\n{done.stderr}'
    return out


@pytest.fixture(scope='module')
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of 30 s."""
    return _demo(tmp_path_factory.mktemp('demo'))


@pytest.fixture(scope='module')
def summary(demo: Path) -> dict[str, Any]:
    """Its summary."""
    read: dict[str, Any] = json.loads((demo / 'summary.json').read_text())
    return read


@pytest.mark.rig
def test_the_summary_tells_of_a_loop_that_closed(summary: dict[str, Any]) -> None:
    assert summary['goals_reached'] == summary['goals']
    assert 0 < summary['goal_error_um'] <= 5
    assert len(summary['estimate']) == 4
    for found in summary['estimate'].values():
        assert found['speed_um_s'] == pytest.approx(found['true_speed_um_s'], rel=0.05)
        apart = np.angle(np.exp(1j * (found['phi_rad'] - found['true_phi_rad'])))
        assert abs(apart) <= 0.1
    assert summary['amplifier']['crc_errors'] == 0
    assert summary['amplifier']['frames'] > 1000
    assert summary['frames'] > 1500
    assert set(summary['latency_ms']) == {'p50', 'p99'}
    assert len(set(summary['controllers'])) >= 2
    assert {'virtual_rig', 'tracker', 'model', 'controller', 'coil_driver',
            'recorder'} <= set(summary['nodes'])


@pytest.mark.rig
def test_rollers_learn_their_gain_and_rest_at_the_last_place(tmp_path: Path) -> None:
    out = _demo(tmp_path, '--robots', 'rolling', '--seconds', '22')
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['goals_reached'] == summary['goals'] == 3
    assert summary['goal_error_um'] <= 2
    assert summary['controllers'] == ['hold', 'open_loop', 'roller', 'hold']
    for found in summary['estimate'].values():
        assert found['speed_um_s'] == pytest.approx(found['true_speed_um_s'], rel=0.05)
        assert abs(found['phi_rad'] - found['true_phi_rad']) <= 0.1
    entries = [json.loads(line) for line in (out / 'amplifier.jsonl').read_text().splitlines()]
    assert len(entries[0]['currents_A']) == 6
    assert not any(entries[-1]['currents_A'])


@pytest.mark.rig
def test_currents_flowed_and_ended_at_zero(demo: Path) -> None:
    entries = [json.loads(line) for line in (demo / 'amplifier.jsonl').read_text().splitlines()]
    assert any(any(entry['currents_A']) for entry in entries)
    assert not any(entries[-1]['currents_A'])
    assert watchdogs(demo) == 1  # when arming tried it out


@pytest.mark.rig
def test_the_film_and_the_figure_show_something(demo: Path) -> None:
    film = cv2.VideoCapture(str(demo / 'demo.mp4'))
    pictures = []
    while True:
        got, picture = film.read()
        if not got:
            break
        pictures.append(picture)
    assert len(pictures) > 200
    assert np.abs(pictures[-1].astype(int) - pictures[0]).max() > 50
    assert cv2.imread(str(demo / 'demo.png')).std() > 10


@pytest.mark.parametrize('arguments', [
    ['--seconds', '3'], ['--seconds', 'nan'], ['--sedond', '1']])
def test_bad_options_are_one_line_and_two(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    assert microbot('demo', '--out', tmp_path / 'out', *arguments) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


class Demo:
    """A demo that is not left to its end."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._said = folder / 'said.txt'
        with self._said.open('w') as said:
            self.process = subprocess.Popen(
                [sys.executable, '-m', 'microbot_ros.cli', 'demo', '--seconds', '15', '--out',
                 str(folder / 'out')], stderr=said, stdout=subprocess.DEVNULL)

    @property
    def said(self) -> str:
        """What it has printed so far."""
        return self._said.read_text()

    def until(self, line: str) -> list[psutil.Process]:
        """Wait for it to say something; the processes that it has by then."""
        deadline = time.monotonic() + 200
        while line not in self.said:
            assert time.monotonic() < deadline, self.said
            assert self.process.poll() is None, self.said
            time.sleep(0.01)
        return psutil.Process(self.process.pid).children()

    def log(self) -> TextIO:
        """The amplifier's log, which can be read on when its name is gone."""
        return next(self.folder.glob('.out.*/amplifier.jsonl')).open()


@pytest.fixture
def begun(tmp_path: Path) -> Iterator[Demo]:
    """A demo that has begun."""
    demo = Demo(tmp_path)
    yield demo
    demo.process.kill()
    demo.process.wait(20)


def _zero_after(log: TextIO, moment: float) -> float:
    """How long after a moment the last current ended [s]."""
    entries = [json.loads(line) for line in log]
    assert not any(entries[-1]['currents_A'])
    last = max(n for n, entry in enumerate(entries) if any(entry['currents_A']))
    assert entries[last + 1]['cause'] != 'watchdog'  # which is tried out on arming, before
    return float(entries[last + 1]['t_monotonic_s'] - moment)


@pytest.mark.rig
@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP])
def test_a_stopped_demo_is_at_zero_says_so_and_leaves_nothing(
        begun: Demo, machine: Any, number: int) -> None:
    children = begun.until('s] v = ')
    with begun.log() as log:
        moment = time.monotonic()
        begun.process.send_signal(number)
        time.sleep(0.5)
        kept_waiting_s = machine.kept_waiting_s(moment)
        assert begun.process.wait(30) == 128 + number
        assert _zero_after(log, moment) < 0.1 + kept_waiting_s
    assert f'stopped by {signal.Signals(number).name}' in begun.said
    assert not any(child.is_running() for child in children)
    assert [path.name for path in begun.folder.iterdir()] == ['said.txt']


@pytest.mark.rig
def test_a_demo_stopped_while_it_starts_leaves_nothing(begun: Demo) -> None:
    begun.until('starting')
    begun.process.send_signal(signal.SIGINT)
    assert begun.process.wait(30) == 130
    assert [path.name for path in begun.folder.iterdir()] == ['said.txt']


@pytest.mark.rig
def test_nobody_outlives_a_killed_demo(begun: Demo) -> None:
    children = begun.until('s] armed')
    assert len(children) == 7
    begun.process.kill()
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not alive


def test_places_are_reached_one_after_the_other() -> None:
    goals = np.array([(0.0, 0.0), (9.0, 0.0), (0.0, 9.0)]) * 1e-6
    there = np.array([(0.0, 20.0), (1.0, 1.0), (5.0, 0.0), (9.0, 2.5)]) * 1e-6
    assert goals_reached(there, goals) == 2
    assert goals_reached(there[2:], goals) == 0
    assert goals_reached(np.vstack([there, goals[2:]]), goals) == 3


def test_the_places_are_as_many_as_there_is_time_for() -> None:
    estimates = np.array([(1, 5e-6, 0.0, 2e-6), (0, 1e-6, 2e-6, 4e-6)], [
        ('id', int), ('x', float), ('y', float), ('speed', float)])
    for seconds, count in (9.0, 1), (16.0, 2), (24.0, 3), (0.0, 1):
        places = places_within(seconds, estimates) * 1e6
        assert places == pytest.approx(GOALS_UM[:count] + np.array([1.0, 2.0]))


@pytest.mark.parametrize(('faults', 'reached', 'status'), [
    ([], 3, 0), ([], 2, 1), (['silent'], 3, 1)])
def test_the_status_says_whether_every_place_was_reached(
        faults: list[str], reached: int, status: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert tell_shortcomings(
        faults, {'goals': 3, 'goals_reached': reached, 'goal_error_um': 22.0}, 0.0) == status
    said = capsys.readouterr().err
    assert ('1 of 3 goals not reached' in said) == (reached == 2)
    assert ('the loop was interrupted: silent' in said) == bool(faults)
