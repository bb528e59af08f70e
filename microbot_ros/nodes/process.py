"""Runs one node in this process until a signal: `python -m microbot_ros.nodes tracker`."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn

from microbot_ros.common.compiled import tell_of_compiling
from microbot_ros.common.ending import Ending, Stopped, find_launcher
from microbot_ros.common.errors import InputError
from microbot_ros.common.real_time import LOOP, SAFETY, set_realtime_priority_of_all
from microbot_ros.nodes.base.lifecycle import RigNode
from microbot_ros.nodes.base.names import LOOP_NODES, NODES
from microbot_ros.nodes.base.participant import join, leave
from microbot_ros.nodes.client.graph import READY, WORD

_SPIN_SECONDS = 0.02
"""Longest spin of the executor [s]. Choice: the end is noticed between two spins; zeroing the
coils does not wait for it."""
SWITCH_S = 0.0005
"""Time [s] for which one thread may keep the interpreter from another. Choice: a tenth of Python's
default, as the coil driver has two threads; shorter costs switches."""


def make(name: str, arguments: Sequence[str] | None = None) -> RigNode:
    """Make a node; rclpy must be initialised.

    Parameters
    ----------
    name : str
        Name of the node.
    arguments : sequence of str or None
        ROS arguments of this node alone, `--ros-args` and what follows.

    Returns
    -------
    RigNode
        The node.
    """
    module = importlib.import_module(f'microbot_ros.nodes.{name}')
    node: RigNode = getattr(module, NODES[name])(name, arguments)
    return node


def run(name: str, arguments: list[str] | None = None) -> int:
    """Configure and activate a node, spin until the end, and leave it safe.

    The coils go to zero at once, whatever the executor is doing. The coil driver runs with
    real-time priority if the system grants it; so do the other nodes of the closed loop, once they
    are active. A node that has finished, such as a player at the end of its recording, ends the
    process too.

    Parameters
    ----------
    name : str
        Name of the node.
    arguments : list of str or None
        ROS arguments, `--ros-args` and what follows.

    Returns
    -------
    int
        Exit status: 0 after a signal, 2 if a person must correct an input, 1 otherwise.
    """
    nodes: list[RigNode] = []
    with Ending(lambda: _zero(nodes), find_launcher()) as ending:
        tell_of_compiling(partial(print, flush=True))
        if name == 'coil_driver':
            set_realtime_priority_of_all(SAFETY)
        try:
            join(arguments)
        except InputError as error:
            return _refused(error)
        executor = EventsExecutor()
        try:
            with ending.interrupts():  # the first time code is compiled, for minutes
                nodes.append(node := make(name))
                executor.add_node(node)
                _refuse_elsewhere(node, arguments or [])
                _activate(node)
            _settle(name)
            print(READY, name, flush=True)
            while not (ending.due or node.finished):
                spin_once(executor, _SPIN_SECONDS)
            return _told_fault(node)
        except Stopped:
            return 0
        except InputError as error:
            return _refused(error)
        finally:
            _zero(nodes)
            for made in nodes:
                made.make_safe_and_close()
                executor.remove_node(made)
                made.destroy_node()
            executor.shutdown()
            rclpy.try_shutdown()


def spin_once(executor: Executor, seconds: float) -> None:
    """Call at most one callback, as `Executor.spin_once` does.

    rclpy raises InvalidHandle when a publisher came or went and the subscription was destroyed
    before that was handled. That ended a driver that was cleaned up just then.

    Parameters
    ----------
    executor : Executor
        The executor.
    seconds : float
        Longest time to wait for a callback [s].
    """
    with suppress(InvalidHandle):
        executor.spin_once(timeout_sec=seconds)


def _refused(error: InputError) -> int:
    """Print what a person must correct; return the exit status."""
    print(f'{WORD}{error}', file=sys.stderr)
    return 2


def _refuse_elsewhere(node: RigNode, arguments: list[str]) -> None:
    """Raise InputError if a parameter file means a node of this name in another namespace."""
    from microbot_ros.nodes.configuration import refuse_elsewhere

    for word, file in pairwise(arguments):
        if word == '--params-file':
            refuse_elsewhere(file, node.get_name(), node.get_namespace())


def _settle(name: str) -> None:
    """Prepare for the loop: everything slow is done, and every millisecond counts from now on."""
    # Imported objects are permanent; collecting them would take 40 ms within a tick.
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_S)
    if name in LOOP_NODES:
        set_realtime_priority_of_all(LOOP)


def _told_fault(node: RigNode) -> int:
    """Print why a node has finished; return the exit status."""
    if not (node.finished and node.fault):
        return 0
    print(f'{WORD}{node.fault}', file=sys.stderr)
    return 1


def _zero(nodes: list[RigNode]) -> None:
    """Zero the coils if the node drives any; callable from any thread."""
    for node in nodes:
        if type(node).__name__ == NODES['coil_driver']:
            node.make_safe()


def _activate(node: RigNode) -> None:
    steps: tuple[Callable[[], TransitionCallbackReturn], ...] = (
        node.trigger_configure, node.trigger_activate)
    node.starting = True
    for step in steps:
        if step() != TransitionCallbackReturn.SUCCESS:
            raise InputError(node.get_name(), node.fault.removeprefix(f'{node.get_name()}: '))
    node.starting = False


def main() -> None:
    """Run `python -m microbot_ros.nodes NODE [--ros-args ...]`."""
    names, arguments = sys.argv[1:2], sys.argv[2:]
    if not names or names[0] not in NODES:
        print(f'usage: python -m microbot_ros.nodes NODE [--ros-args ...]\n'
              f'nodes: {", ".join(NODES)}', file=sys.stderr)
        sys.exit(2)
    leave(run(names[0], arguments))


def script() -> None:
    """Run the node that the console script is named after, as `tracker_node --ros-args ...`."""
    leave(run(Path(sys.argv[0]).stem.removesuffix('_node'), sys.argv[1:]))
