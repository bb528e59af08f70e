"""Nodes and commands in the process of the tests.

All nodes of a test process share one rclpy context in one domain. The test spins their executor
itself, until what it waits for has come; deadlines are for tests that fail, and no assertion.
"""

from __future__ import annotations

import gc
import io
import os
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import rclpy
import rclpy.utilities
from command_line import microbot
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.publisher import Publisher
from rig_file import write_rig

from microbot_ros.nodes.base.lifecycle import RigNode
from microbot_ros.nodes.base.participant import join
from microbot_ros.nodes.process import SWITCH_S, make, spin_once

FAILSAFE_S = 60.0
"""After this a test gives up. A machine that is overloaded needs a tenth of it."""
LINGER_S = 10.0
"""Within this a thread has ended that still refers to a node which has ended; later, the test that
keeps it fails."""
PATIENT: dict[str, dict[str, Any]] = {
    'coil_driver': {'command_timeout_ms': 2000.0, 'max_command_age_ms': 2000.0,
                    'settling_ms': 2000.0, 'feedback_timeout_ms': 5000.0},
    'controller': {'deadline_ms': 1000.0, 'pose_timeout_ms': 2000.0}}
"""Times that a process exceeds that is held up for half a second, at their largest."""


@cache
def _join() -> None:
    """Let this process take part in the graph of its domain, until it ends.

    Its threads take turns as those of a rig's process do: the test's own must not hold up the
    driver's for 5 ms at each byte.
    """
    join([])
    sys.setswitchinterval(SWITCH_S)


@contextmanager
def own_context() -> Iterator[None]:
    """Let code that calls `rclpy.init` have a context of its own meanwhile."""
    before, rclpy.utilities.g_default_context = rclpy.utilities.g_default_context, None
    try:
        yield
    finally:
        rclpy.try_shutdown()
        rclpy.utilities.g_default_context = before


class Ros:
    """Nodes of one test, a probe that talks to them, and their executor.

    `parameters` are by node; those of `PATIENT` go before where they are not given.
    """

    def __init__(self, folder: Path, parameters: dict[str, dict[str, Any]]) -> None:
        _join()
        self._file = folder / 'parameters.yaml'
        names = {*parameters, *PATIENT}
        write_rig(self._file, {
            f'/**/{name}': PATIENT.get(name, {}) | parameters.get(name, {}) for name in names})
        self.probe = rclpy.create_node('probe')
        self._executor = EventsExecutor()
        self._executor.add_node(self.probe)
        self.nodes: dict[str, RigNode] = {}

    def add(self, name: str, namespace: str = '/') -> RigNode:
        """Make a node and configure and activate it; look at its `active` and `fault`."""
        node = make(name, ['--ros-args', '--params-file', str(self._file),
                                 '-r', f'__ns:={namespace}'])
        self.nodes[node.get_fully_qualified_name().removeprefix('/')] = node
        self._executor.add_node(node)
        if node.trigger_configure().name == 'SUCCESS':
            node.trigger_activate()
        return node

    def until(self, true: Callable[[], Any]) -> None:
        """Spin until something is true; fail if it does not become so."""
        deadline = time.monotonic() + FAILSAFE_S
        while not true():
            assert time.monotonic() < deadline, 'did not happen'
            spin_once(self._executor, 0.01)
            # A test that commands in `true` must not flood the line faster than the emulated
            # amplifier, a thread of this process, reads it.
            time.sleep(0.001)

    def hear(self, kind: type, topic: str, qos: Any = 100) -> list[Any]:
        """Return a list that fills with the messages of a topic."""
        heard: list[Any] = []
        self.probe.create_subscription(kind, topic, heard.append, qos)
        return heard

    def talk(self, kind: type, topic: str, qos: Any = 10) -> Publisher:
        """Return a publisher of a topic that one node listens to, once it does."""
        publisher = self.probe.create_publisher(kind, topic, qos)
        self.until(lambda: publisher.get_subscription_count() == 1)
        return publisher

    def call(self, kind: type, name: str, request: Any) -> Any:
        """Return the answer of a service."""
        client = self.probe.create_client(kind, name)
        try:
            self.until(client.service_is_ready)
            future = client.call_async(request)
            self.until(future.done)
            return future.result()
        finally:
            self.probe.destroy_client(client)

    @contextmanager
    def spinning(self) -> Iterator[None]:
        """Spin in a thread meanwhile, so that the test can wait for the nodes elsewhere."""
        ending = threading.Event()

        def spin() -> None:
            while not ending.is_set():
                spin_once(self._executor, 0.01)
        thread = threading.Thread(target=spin, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ending.set()
            thread.join()

    def microbot(self, *words: object) -> tuple[int, str, str]:
        """Run a command beside the nodes; return its exit status and its two outputs."""
        with self.spinning():
            return command(*words)

    def end(self) -> None:
        """Leave nothing running."""
        for node in self.nodes.values():
            node.make_safe_and_close()
            self._executor.remove_node(node)
        self._executor.remove_node(self.probe)
        # Anything queued would keep its node for ever, and fail once that is destroyed.
        run_queue(self._executor)
        ended = []
        while self.nodes:
            name, node = self.nodes.popitem()
            ended.append((name, weakref.ref(node)))
            node.destroy_node()
            del node
        self.probe.destroy_node()
        self._executor.shutdown()
        vars(self).clear()  # what a test added to it, too
        # The graph, which later tests of this process share, shows a node for as long as anything
        # refers to it, such as a thread that has not quite ended.
        gc.collect()
        deadline = time.monotonic() + LINGER_S
        while kept := [name for name, node in ended if node()]:
            assert time.monotonic() < deadline, f'{kept} are still referred to: {_by_what(ended)}'
            time.sleep(0.02)
            gc.collect()
        gc.freeze()  # what is left is not the next test's to look through: 80 ms


def keep_commands_valid(driver: RigNode, command_timeout_s: float = FAILSAFE_S) -> None:
    """Let no command of a coil driver go stale, however long this process is held up."""
    gate = driver._driver.gate  # type: ignore[attr-defined]
    gate.limits = replace(gate.limits, command_timeout_s=command_timeout_s)


def run_queue(executor: Executor) -> None:
    """Let an executor act on all that is queued so far."""
    last = executor.create_task(lambda: None)
    while not last.done():
        spin_once(executor, 0.01)


def _by_what(ended: list[tuple[str, weakref.ref[RigNode]]]) -> list[str]:
    """What refers to nodes that should be gone, and the functions in which threads stand."""
    running = [f'{frame.f_code.co_qualname}:{frame.f_lineno}'
               for frame in sys._current_frames().values()]
    return [repr(by)[:200] for _, node in ended if (kept := node())
            for by in gc.get_referrers(kept)] + running


class _Output(io.StringIO):
    """Output that is kept, for libraries that want a descriptor too."""

    def fileno(self) -> int:
        """Return the descriptor of the standard error of this process."""
        assert sys.__stderr__ is not None
        return sys.__stderr__.fileno()


def command(*words: object) -> tuple[int, str, str]:
    """Run `microbot` in this process; return its exit status and its two outputs."""
    out, error = _Output(), _Output()
    with redirect_stdout(out), redirect_stderr(error):
        status = microbot(*words)
    return status, out.getvalue(), error.getvalue()


def graphs(folder: Path) -> Iterator[Callable[[dict[str, dict[str, Any]]], Ros]]:
    """Make graphs from parameters for one test, and end them: the body of a fixture."""
    assert os.environ['ROS_DOMAIN_ID']
    with ExitStack() as made:  # all end, also where a test keeps a node of one

        def start(parameters: dict[str, dict[str, Any]]) -> Ros:
            graph = Ros(folder, parameters)
            made.callback(graph.end)
            return graph
        yield start
