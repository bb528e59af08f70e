"""Two rigs at once, each in a namespace with parameters, services and diagnostics of its own."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import films
import numpy as np
import pytest
from rig_file import write_rig

from bench._emulator import EmulatorProcess
from microbot_ros.common.errors import InputError, RigError
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.nodes.configuration import read_rig, refuse_elsewhere

CONFIG = Path(__file__).parents[2] / 'config' / 'rig.yaml'


def test_sections_are_those_that_ros_gives_to_a_node(tmp_path: Path) -> None:
    file = write_rig(tmp_path / 'rig.yaml', {
        'controller': {'max_field_mT': 1.0}, '/rig_2/controller': {'max_field_mT': 2.0},
        '/*/controller': {'delay_ms': 3.0}, '/lab/**/controller': {'max_field_mT': 4.0}})
    assert read_rig(file, '/') == {'controller': {'max_field_mT': 1.0}}
    assert read_rig(file, '/rig_2') == {'controller': {'max_field_mT': 2.0, 'delay_ms': 3.0}}
    assert read_rig(file, '/rig_3') == {'controller': {'delay_ms': 3.0}}
    assert read_rig(file, '/lab/a/b') == {'controller': {'max_field_mT': 4.0}}


def test_a_file_that_a_namespace_would_ignore_is_refused(tmp_path: Path) -> None:
    """The limit of a field would stay at its default, without a word."""
    file = write_rig(tmp_path / 'rig.yaml', {'coil_driver': {'current_limit_A': 0.1}})
    for refusing in (lambda: read_rig(file, '/rig_2'),
                     lambda: refuse_elsewhere(file, 'coil_driver', '/rig_2')):
        with pytest.raises(InputError, match=r"rig.yaml:1: 'coil_driver' is not a node of the "
                                             r"namespace /rig_2; '/\*\*/coil_driver' would fit"):
            refusing()
    refuse_elsewhere(file, 'coil_driver', '/')
    refuse_elsewhere(file, 'camera', '/rig_2')
    refuse_elsewhere(CONFIG, 'coil_driver', '/rig_2')


@pytest.mark.rig
@pytest.mark.timeout(240)
def test_two_rigs_are_driven_at_once(tmp_path: Path) -> None:
    """From one file: the field of one is twice that of the other, and one is disarmed alone."""
    film = films.film(tmp_path / 'film', 30)
    rigs = ('rig_1', 'rig_2')
    with ExitStack() as leave:
        for rig in rigs:
            (tmp_path / rig).mkdir()
        emulators = {rig: leave.enter_context(EmulatorProcess(tmp_path / rig)) for rig in rigs}
        file = write_rig(tmp_path / 'rig.yaml', {
            '/**/camera': {'source': str(film), 'frame_rate_hz': 20.0, 'loop': True},
            '/**/tracker': {'pixel_size_um': 0.45}, '/**/model': {},
            '/**/controller': {'controller': 'open_loop', 'open_loop.durations_s': [3600.0],
                               'open_loop.directions_deg': [45.0]},
            '/**/coil_driver': {'full_scale_A': 2.0, 'command_timeout_ms': 500.0,
                                'max_command_age_ms': 500.0},
            **{f'/{rig}/controller': {'open_loop.field_mT': field}
               for rig, field in zip(rigs, (2.0, 4.0), strict=True)},
            **{f'/{rig}/coil_driver': {'port': emulators[rig].url} for rig in rigs}})
        for rig in rigs:
            process = subprocess.Popen(
                [sys.executable, '-m', 'microbot_ros.cli', 'run', '--config', str(file),
                 '--namespace', rig], stderr=subprocess.DEVNULL)
            leave.callback(process.wait)
            leave.callback(process.terminate)
        for rig in rigs:
            _until(lambda rig=rig: _armed(rig) and not emulators[rig].zero, 120)
        _until(lambda: _ratio(emulators) == pytest.approx(2, rel=0.05), 60)
        heard: dict[str, str] = {}
        with GraphClient(namespace='rig_2') as client:
            client.watch_health(lambda node, _, sentence, __: heard.setdefault(node, sentence))
            assert client.until(lambda: 'coil_driver' in heard, 10)
            assert client.get('controller', 'open_loop.field_mT') == {'open_loop.field_mT': 4.0}
        with GraphClient(namespace='rig_1') as client:
            client.stop()
        _until(lambda: emulators['rig_1'].zero, 10)
        assert not emulators['rig_2'].zero


def _armed(rig: str) -> bool:
    try:
        with GraphClient(namespace=rig) as client:
            client.arm()
    except RigError:
        return False
    return True


def _ratio(emulators: dict[str, Any]) -> float:
    first, second = (np.abs(emulators[rig].currents).max() for rig in ('rig_1', 'rig_2'))
    return float(second / first) if first else 0.0


def _until(true: Any, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.05)
