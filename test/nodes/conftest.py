"""Fixtures of the tests of nodes: a graph and an amplifier in this process, or an amplifier apart.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from in_process import Ros, graphs

from bench._emulator import Emulated, EmulatorProcess, Served
from microbot_ros.common.real_time import set_realtime_priority


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
             emulator_options: dict[str, Any]) -> Iterator[Emulated]:
    """An emulated amplifier that is switched off at the end; for the rig's tests, which measure
    times, in a process of its own.
    """
    apart = any(request.node.get_closest_marker(suite) for suite in ('rig', 'soak'))
    options = [word for name, value in emulator_options.items()
               for word in (f'--{name}', str(value))]
    with (EmulatorProcess(tmp_path, 'serial_transfer', *options) if apart
          else Served(tmp_path, **emulator_options)) as made:
        yield made


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Callable[[dict[str, dict[str, Any]]], Ros]]:
    """Makes a graph in this process from parameters; ends it afterwards."""
    yield from graphs(tmp_path)
