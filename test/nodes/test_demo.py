"""The demo, whole: its numbers, its files, and another reader's view of its recording."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


@pytest.fixture(scope='module')
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a demo of 30 s leaves behind."""
    out = tmp_path_factory.mktemp('demo') / 'demo'
    done = subprocess.run(
        [sys.executable, '-m', 'microbot_ros.cli', 'demo', '--out', str(out)],
        capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope='module')
def summary(demo: Path) -> dict[str, Any]:
    """Its summary."""
    read: dict[str, Any] = json.loads((demo / 'summary.json').read_text())
    return read


def test_the_steered_particle_is_at_its_goal(summary: dict[str, Any]) -> None:
    assert 0 < summary['goal_error_um'] <= 5


def test_every_estimate_is_near_the_truth(summary: dict[str, Any]) -> None:
    assert len(summary['estimate']) == 4
    for found in summary['estimate'].values():
        assert found['speed_um_s'] == pytest.approx(found['true_speed_um_s'], rel=0.05)
        apart = np.angle(np.exp(1j * (found['phi_rad'] - found['true_phi_rad'])))
        assert abs(apart) <= 0.1


def test_the_line_was_clean_and_the_controller_swapped(summary: dict[str, Any]) -> None:
    assert summary['amplifier']['crc_errors'] == 0
    assert summary['amplifier']['frames'] > 1000
    assert summary['frames'] > 1500
    assert set(summary['latency_ms']) == {'p50', 'p99'}
    assert len(set(summary['controllers'])) >= 2
    assert {'virtual_rig', 'tracker', 'model', 'controller', 'coil_driver',
            'recorder'} <= set(summary['nodes'])


def test_currents_flowed_and_ended_at_zero(demo: Path) -> None:
    entries = [json.loads(line) for line in (demo / 'amplifier.jsonl').read_text().splitlines()]
    assert any(any(entry['currents_A']) for entry in entries)
    assert not any(entries[-1]['currents_A'])
    assert not any(entry['cause'] == 'watchdog' for entry in entries)


def test_another_reader_opens_the_recording(demo: Path) -> None:
    files = sorted((demo / 'recording').glob('*.mcap'))
    with files[0].open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert {'/camera/image_raw', '/particles', '/model/state', '/field/command', '/field/applied',
            '/coils/command', '/coils/applied', '/coils/measured', '/goals',
            '/diagnostics'} <= topics


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
def test_bad_options_are_one_line_and_two(tmp_path: Path, arguments: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'microbot_ros.cli', 'demo', '--out', str(tmp_path / 'out'),
         *arguments], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())
