"""`microbot run` with real processes: whatever dies, the coils end at zero and the rest lives."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import films
import psutil
import pytest
from rig_file import write_rig

from microbot_ros.common.errors import RigError
from microbot_ros.common.real_time import LOOP, SAFETY
from microbot_ros.nodes.client.graph_client import GraphClient

pytestmark = [pytest.mark.rig, pytest.mark.timeout(240)]
DEAD_MAN_S = 0.4
"""Driver 0.1 s or device watchdog 0.1 s, and what a loaded machine adds to a process's death."""
SIGNAL_S = 0.1
"""Asked for: from a signal to zero."""


@pytest.fixture(scope='module')
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the camera node plays in a loop."""
    return films.film(tmp_path_factory.mktemp('films') / 'film', 60)


class Running:
    """`microbot run` in a process of its own, and a client of its graph."""

    def __init__(self, folder: Path, film: Path, emulator: Any,
                 **more: dict[str, Any]) -> None:
        nodes: dict[str, dict[str, Any]] = {
            'camera': {'source': str(film), 'frame_rate_hz': 30.0, 'loop': True},
            'tracker': {'pixel_size_um': 0.45},
            'model': {},
            'controller': {'controller': 'open_loop', 'open_loop.durations_s': [3600.0],
                           'open_loop.directions_deg': [45.0]},
            'coil_driver': {'port': emulator.url, 'full_scale_A': 2.0},
            **more,
        }
        config = write_rig(folder / 'rig.yaml', nodes)
        self.emulator = emulator
        self.said = (folder / 'said.txt')
        with self.said.open('w') as said:
            self.process = subprocess.Popen(
                [sys.executable, '-m', 'microbot_ros.cli', 'run', '--config', str(config)],
                stderr=said, stdout=subprocess.DEVNULL, start_new_session=True)

    def drive(self) -> None:
        """Wait until all nodes run, and let currents flow."""
        self.until(lambda: 'running: ' in self.said.read_text(), 120)
        with GraphClient('test') as client:
            self.until(lambda: self._driving(client), 60)

    def _driving(self, client: GraphClient) -> bool:
        """Arm, again where a busy machine made the gate trip; whether currents flow by then."""
        try:
            client.arm()
        except RigError:  # what flows now are pulses of its check
            return False
        deadline = time.monotonic() + 2
        while self.emulator.zero and time.monotonic() < deadline:
            time.sleep(0.01)
        return not self.emulator.zero

    def until(self, true: Any, seconds: float) -> None:
        """Wait for something to become true."""
        deadline = time.monotonic() + seconds
        while not true():
            assert self.process.poll() is None, self.said.read_text()
            assert time.monotonic() < deadline, self.said.read_text()
            time.sleep(0.01)

    def node(self, name: str) -> psutil.Process:
        """The process of a node."""
        return next(child for child in psutil.Process(self.process.pid).children()
                    if name in child.cmdline()[3:])

    def zero_after(self, moment: float) -> float:
        """Wait for zero currents; how long after a moment they came [s]."""
        deadline = time.monotonic() + 10
        while not self.emulator.zero:
            assert time.monotonic() < deadline
            time.sleep(0.005)
        last = self.emulator.entries()[-3:]
        print(f'since the signal: {last}\n{self.said.read_text()}')  # told where a test fails
        return float(last[-1]['t_monotonic_s'] - moment)

    def end(self) -> None:
        """Leave nothing behind."""
        if self.process.poll() is None:
            for child in psutil.Process(self.process.pid).children():
                child.kill()
            self.process.kill()
        self.process.wait(10)


def _driven(made: Running) -> Iterator[Running]:
    try:
        made.drive()
        yield made
    finally:
        made.end()


@pytest.fixture
def running(tmp_path: Path, film: Path, emulator: Any) -> Iterator[Running]:
    """A rig whose coils are driven, a process per node."""
    yield from _driven(Running(tmp_path, film, emulator))


def test_the_whole_loop_runs_in_real_time_where_the_system_grants_it(
        running: Running, real_time: bool) -> None:
    ending = SAFETY  # the thread that hears of the end
    expected = {name: {LOOP, ending} for name in ('camera', 'tracker', 'model', 'controller')}
    expected['coil_driver'] = {SAFETY}
    found = {}
    for name in expected:
        process = running.node(name)
        found[name] = {os.sched_getparam(thread.id).sched_priority for thread in process.threads()}
    assert found == (expected if real_time else {name: {0} for name in expected})


@pytest.mark.parametrize('victim', ['tracker', 'coil_driver'])
def test_a_killed_node_means_zero_and_the_others_live(
        running: Running, machine: Any, victim: str) -> None:
    others = [running.node(name) for name in ('camera', 'model', 'controller')]
    moment = time.monotonic()
    running.node(victim).kill()
    assert running.zero_after(moment) < DEAD_MAN_S + machine.kept_waiting_s(moment)
    running.until(lambda: f'{victim}: ended with status -9' in running.said.read_text(), 10)
    assert all(other.is_running() for other in others)
    running.process.send_signal(signal.SIGINT)
    assert running.process.wait(20) == 0
    assert not any(other.is_running() for other in others)


def test_a_stopped_controller_means_zero(running: Running, machine: Any) -> None:
    moment = time.monotonic()
    running.node('controller').send_signal(signal.SIGSTOP)
    assert running.zero_after(moment) < DEAD_MAN_S + machine.kept_waiting_s(moment)


@pytest.fixture
def recorded(tmp_path: Path, film: Path, emulator: Any) -> Iterator[Running]:
    """A rig whose coils are driven and whose recorder has something to write."""
    yield from _driven(Running(tmp_path, film, emulator,
                               recorder={'folder': str(tmp_path / 'recording')}))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_zero_comes_at_once_however_long_the_recorder_takes(
        recorded: Running, machine: Any, tmp_path: Path, number: int) -> None:
    children = psutil.Process(recorded.process.pid).children()
    recorder = recorded.node('recorder')
    recorder.suspend()  # as one that waits for a disk: it neither hears nor ends
    moment = time.monotonic()
    os.kill(recorded.process.pid, number)
    assert recorded.zero_after(moment) < SIGNAL_S + machine.kept_waiting_s(moment)
    kept_waiting_s = machine.kept_waiting_s(moment)
    with pytest.raises(subprocess.TimeoutExpired):
        recorded.process.wait(5)
    recorder.resume()
    assert recorded.process.wait(20) == 0
    assert (tmp_path / 'recording' / 'metadata.yaml').is_file()
    assert not any(child.is_running() for child in children)
    last = recorded.emulator.entries()[-1]
    assert last['cause'] == 'command'
    assert not any(last['currents_A'])
    assert last['t_monotonic_s'] - moment < SIGNAL_S + kept_waiting_s


def test_a_killed_launcher_means_zero_and_nobody_stays(
        running: Running, machine: Any) -> None:
    children = psutil.Process(running.process.pid).children()
    moment = time.monotonic()
    running.process.kill()
    assert running.zero_after(moment) < DEAD_MAN_S + machine.kept_waiting_s(moment)
    running.process.wait(20)
    psutil.wait_procs(children, timeout=10)
    assert not any(child.is_running() for child in children)


def test_what_only_a_node_can_find_wrong_is_one_line_that_says_where(tmp_path: Path) -> None:
    config = write_rig(tmp_path / 'rig.yaml', {
        'model': {}, 'camera': {'source': f'/x/{"y" * 9000}'}})
    process = subprocess.Popen([sys.executable, '-m', 'microbot_ros.cli', 'run', '--config',
                                str(config)], stderr=subprocess.PIPE, text=True)
    _, said = process.communicate(timeout=120)
    *before, line = said.splitlines()
    assert line.startswith(f'microbot: {config}:3: camera: source: /x/{"y" * 76}…: ')
    assert all('compiling code for the first time' in note for note in before), said
    assert process.returncode == 2
