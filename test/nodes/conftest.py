"""Fixtures of the tests of nodes: a graph and an amplifier in this process, or an amplifier apart.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from in_process import FULL_SCALE_A, Amplifier, Ros, graphs

from microbot_ros.common.real_time import set_realtime_priority


class EmulatorProcess:
    """The emulated amplifier in its own process."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.port = folder / 'amplifier'
        self.log = folder / 'amplifier.jsonl'
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'emulate', 'serial_transfer', '--link',
             str(self.port), '--log', str(self.log), '--full-scale-A', str(FULL_SCALE_A),
             *options], stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert 'serving' in self.process.stdout.readline()

    def entries(self) -> list[dict[str, Any]]:
        """What the log holds so far."""
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    @property
    def currents(self) -> list[float]:
        """What flows now."""
        return list(json.loads(self.log.read_text().splitlines()[-1])['currents_A'])

    @property
    def zero(self) -> bool:
        """Whether nothing flows."""
        return not any(self.currents)

    def end(self) -> None:
        """Switch off, as pulling the plug does."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        self.process.communicate(timeout=10)


class Machine:
    """How long this machine keeps even a real-time thread waiting: a neighbour may have its
    processors.

    A bound in milliseconds holds on top of that.
    """

    def __init__(self) -> None:
        self._late: list[tuple[float, float]] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        set_realtime_priority()
        while not self._ending.is_set():
            begin = time.monotonic()
            time.sleep(0.002)
            now = time.monotonic()
            self._late.append((now, max(now - begin - 0.003, 0.0)))

    def kept_waiting_s(self, since: float) -> float:
        """How long, all in all, since a moment on the monotonic clock [s]."""
        return sum(late for t, late in self._late if t >= since)

    def end(self) -> None:
        """Watch no more."""
        self._ending.set()
        self._thread.join()


@pytest.fixture
def machine() -> Iterator[Machine]:
    """Watches the machine during a test."""
    made = Machine()
    yield made
    made.end()


@pytest.fixture
def emulator_options() -> dict[str, Any]:
    """How the emulated amplifier differs from an ordinary one."""
    return {}


@pytest.fixture
def emulator(request: pytest.FixtureRequest, tmp_path: Path,
             emulator_options: dict[str, Any]) -> Iterator[Amplifier | EmulatorProcess]:
    """An emulated amplifier that is switched off at the end; for the rig's tests, which measure
    times, in a process of its own.
    """
    apart = any(request.node.get_closest_marker(suite) for suite in ('rig', 'soak'))
    options = [word for name, value in emulator_options.items()
               for word in (f'--{name}', str(value))]
    made = (EmulatorProcess(tmp_path, *options) if apart
            else Amplifier(tmp_path, **emulator_options))
    yield made
    made.end()


@pytest.fixture
def emulator_in() -> Iterator[Callable[[Path], EmulatorProcess]]:
    """Makes emulated amplifiers, each in a folder, that are switched off at the end."""
    made: list[EmulatorProcess] = []

    def start(folder: Path) -> EmulatorProcess:
        folder.mkdir()
        made.append(EmulatorProcess(folder))
        return made[-1]

    yield start
    for emulator in made:
        emulator.end()


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Callable[[dict[str, dict[str, Any]]], Ros]]:
    """Makes a graph in this process from parameters; ends it afterwards."""
    yield from graphs(tmp_path)
