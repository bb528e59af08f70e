"""What runs nodes in a process: started, joined, and ended with the coils at zero."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from in_process import PATIENT, command, own_context

from microbot_ros.nodes import process
from microbot_ros.nodes.graph import READY
from microbot_ros.nodes.graph_client import GraphClient


@pytest.fixture(autouse=True)
def _ordinary(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave the priorities and the heap of the tests' process alone."""
    for name in ('set_realtime_priority_of_all', 'leave'):
        monkeypatch.setattr(process, name, lambda *_: None)
    for name in ('gc.freeze', 'sys.setswitchinterval'):
        monkeypatch.setattr(f'microbot_ros.nodes.process.{name}', lambda *_: None)
    with own_context():
        yield


def _arguments(folder: Path, nodes: dict[str, dict[str, Any]]) -> list[str]:
    file = folder / 'nodes.yaml'
    file.write_text(yaml.safe_dump(
        {name: {'ros__parameters': PATIENT.get(name, {}) | values}
         for name, values in nodes.items()}))
    return ['--ros-args', '--params-file', str(file)]


def _once_settled(monkeypatch: pytest.MonkeyPatch, do: Callable[[], None]) -> threading.Thread:
    """Do something in a thread once the nodes run, and then end them by a signal."""
    def act() -> None:
        try:
            do()
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
    thread = threading.Thread(target=act)
    settle = process._settle

    def settled(*what: Any) -> None:
        settle(*what)
        thread.start()
    monkeypatch.setattr(process, '_settle', settled)
    return thread


def test_a_joined_loop_drives_and_a_signal_ends_it_at_zero(
        tmp_path: Path, emulator: Any, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    film = tmp_path / 'film'
    film.mkdir()
    rng = np.random.default_rng(3)
    for k in range(20):
        cv2.imwrite(str(film / f'{k}.png'), rng.integers(0, 255, (64, 64)).astype(np.uint8))
    arguments = _arguments(tmp_path, {
        'camera': {'source': str(film), 'frame_rate_hz': 30.0, 'loop': True},
        'tracker': {}, 'model': {}, 'controller': {},
        'coil_driver': {'port': str(emulator.port)}})
    flowed: list[bool] = []

    def drive() -> None:
        with GraphClient('test') as client:
            armed: list[bool] = []
            client.watch_health(lambda node, _, __, values: armed.append(
                node == 'coil_driver' and values['armed'] == 'True'))
            client.arm()
            assert client.until(lambda: armed and armed[-1], 60.0)
            flowed.append(any(any(entry['currents_A']) for entry in emulator.entries()))
    thread = _once_settled(monkeypatch, drive)
    assert process.run([*process.LOOP_NODES], arguments) == 0
    thread.join()
    assert f'{READY} camera tracker model controller coil_driver' in capfd.readouterr().out
    assert flowed == [True]
    assert emulator.zero


def test_a_node_that_cannot_begin_is_one_line_and_two(
        tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = _arguments(tmp_path, {'camera': {'source': '/nowhere/film.mp4'}})
    assert process.run(['camera'], arguments) == 2
    said = [line for line in capfd.readouterr().err.splitlines() if 'microbot: ' in line]
    assert len(said) == 1
    assert '/nowhere/film.mp4' in said[0]


def test_a_node_that_would_ignore_its_file_does_not_start(
        tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = _arguments(tmp_path, {'coil_driver': {'current_limit_A': 0.1}})
    assert process.run(['coil_driver'], [*arguments, '-r', '__ns:=/rig_2']) == 2
    assert '/**/coil_driver' in capfd.readouterr().err


@pytest.mark.parametrize('words', [[], ['steam'], ['model', 'steam']])
def test_what_is_no_node_is_two(
        words: list[str], monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr('sys.argv', ['nodes', *words])
    with pytest.raises(SystemExit) as ended:
        process.main()
    assert ended.value.code == 2
    assert 'coil_driver' in capfd.readouterr().err


def test_a_page_that_cannot_be_served_is_one_line() -> None:
    pytest.importorskip('uvicorn', reason='the extra `cockpit` is not installed')
    for host in ('NONSENSE', 'x' * 9000):
        status, out, error = command('cockpit', '--host', host)
        line, = (one for one in error.splitlines() if one.startswith('microbot: '))
        assert line.startswith('microbot: cockpit: host: expected a name or an address')
        assert 'x' * 81 not in line
        assert (status, out) == (2, '')
