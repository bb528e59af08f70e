"""Real nodes, a real middleware, a real pseudo-terminal: what the tests of nodes are made of."""

from __future__ import annotations

import gc
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from domains import own_domain
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from microbot_ros.drive.real_time import set_realtime_priority
from microbot_ros.nodes.lifecycle import RigNode
from microbot_ros.nodes.process import make
from microbot_ros.nodes.transport import BY_PROFILE, NODE, transport

FULL_SCALE_A = 2.0


def _elsewhere() -> Iterator[str]:
    """Domains in turn: the middleware shows the nodes of a graph that has ended for a while yet,
    so the next graphs of this process are in others, taken when they are needed."""
    domains = [os.environ['ROS_DOMAIN_ID']]
    yield domains[0]
    for _ in range(15):
        domains.append(str(own_domain()))
        yield domains[-1]
    yield from itertools.cycle(domains)


_DOMAINS = _elsewhere()


class Emulator:
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


class Ros:
    """Nodes of one test in this process, a probe that talks to them, and an executor."""

    def __init__(self, folder: Path, parameters: dict[str, dict[str, Any]]) -> None:
        os.environ['ROS_DOMAIN_ID'] = next(_DOMAINS)
        file = folder / 'parameters.yaml'
        file.write_text(yaml.safe_dump(
            {name: {'ros__parameters': values} for name, values in parameters.items()}))
        with transport(BY_PROFILE, NODE):
            rclpy.init(args=['--ros-args', '--params-file', str(file)],
                       signal_handler_options=SignalHandlerOptions.NO)
            self.probe = rclpy.create_node('probe')
        self._executor = EventsExecutor()
        self.nodes: dict[str, RigNode] = {}
        self._executor.add_node(self.probe)

    def add(self, name: str) -> RigNode:
        """Make a node and configure and activate it; look at its `active` and `fault`."""
        node = self.nodes[name] = make(name)
        self._executor.add_node(node)
        if node.trigger_configure().name == 'SUCCESS':
            node.trigger_activate()
        return node

    def until(self, true: Callable[[], Any], seconds: float = 20.0) -> None:
        """Spin until something is true; fail if it does not become so."""
        deadline = time.monotonic() + seconds
        while not true():
            assert time.monotonic() < deadline, 'did not happen in time'
            self._executor.spin_once(timeout_sec=0.01)

    def hear(self, kind: type, topic: str, qos: Any = 100) -> list[Any]:
        """A list that fills with the messages of a topic."""
        heard: list[Any] = []
        self.probe.create_subscription(kind, topic, heard.append, qos)
        return heard

    def call(self, kind: type, name: str, request: Any) -> Any:
        """The answer of a service."""
        client = self.probe.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def end(self) -> None:
        """Leave nothing running."""
        for node in self.nodes.values():
            node.make_safe_and_close()
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.remove_node(self.probe)
        self.probe.destroy_node()
        self._executor.shutdown()
        rclpy.try_shutdown()
        # The middleware shows nodes to the next graph for as long as anything refers to them.
        self.nodes.clear()
        del self.probe, self._executor
        gc.collect()


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
def emulator_options() -> tuple[str, ...]:
    """What the emulated amplifier is beside the ordinary."""
    return ()


@pytest.fixture
def emulator(tmp_path: Path, emulator_options: tuple[str, ...]) -> Iterator[Emulator]:
    """An emulated amplifier that is switched off at the end."""
    made = Emulator(tmp_path, *emulator_options)
    yield made
    made.end()


@pytest.fixture
def emulator_in() -> Iterator[Callable[[Path], Emulator]]:
    """Makes emulated amplifiers, each in a folder, that are switched off at the end."""
    made: list[Emulator] = []

    def start(folder: Path) -> Emulator:
        folder.mkdir()
        made.append(Emulator(folder))
        return made[-1]

    yield start
    for emulator in made:
        emulator.end()


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Callable[[dict[str, dict[str, Any]]], Ros]]:
    """Makes a graph in this process from parameters; ends it afterwards."""
    made: list[Ros] = []

    def start(parameters: dict[str, dict[str, Any]]) -> Ros:
        made.append(Ros(tmp_path, parameters))
        return made[-1]

    assert os.environ['ROS_DOMAIN_ID']
    yield start
    for graph in made:
        graph.end()
