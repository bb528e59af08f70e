"""Run nodes in this process until a signal: `python -m microbot_ros.nodes tracker model`."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn

from microbot_ros.common.ending import Ending, Stopped, find_launcher
from microbot_ros.common.errors import InputError
from microbot_ros.common.first_compilation import tell_of_compiling
from microbot_ros.common.real_time import LOOP, SAFETY, set_realtime_priority_of_all
from microbot_ros.nodes.graph import READY, WORD
from microbot_ros.nodes.lifecycle import RigNode
from microbot_ros.nodes.participant import join, leave
from microbot_ros.nodes.rig import Rig

NODES = {
    'camera': 'CameraNode',
    'tracker': 'TrackerNode',
    'model': 'ModelNode',
    'controller': 'ControllerNode',
    'coil_driver': 'CoilDriverNode',
    'virtual_rig': 'VirtualRigNode',
    'recorder': 'RecorderNode',
    'player': 'PlayerNode',
    'cockpit': 'CockpitNode',
}
"""Node name → class in the module of the same name; imported only where it runs."""

LOOP_NODES = ('camera', 'tracker', 'model', 'controller', 'coil_driver')
"""What runs in real time, and may share a process, joined by a `Rig`."""

# The end is noticed between two spins. The coils do not wait for that.
_SPIN_SECONDS = 0.02
SWITCH_S = 0.0005
"""How long one thread may keep the interpreter from another: the coil driver has two."""


def processes(names: Sequence[str], joined: bool) -> list[list[str]]:
    """Who of these `names` share a process: those of the loop where they are `joined`."""
    loop = [name for name in names if joined and name in LOOP_NODES]
    return [*filter(None, [loop]), *([name] for name in names if name not in loop)]


def make(name: str, rig: Rig | None = None, arguments: Sequence[str] | None = None) -> RigNode:
    """Make the node of that `name`, joined with others by their `rig`; rclpy must be initialised.

    `arguments` are the ROS arguments of this node alone, `--ros-args` and what follows.
    """
    module = importlib.import_module(f'microbot_ros.nodes.{name}')
    node: RigNode = getattr(module, NODES[name])(name, rig, arguments)
    return node


def run(names: list[str], arguments: list[str] | None = None) -> int:
    """Configure and activate the nodes of these `names`, spin until the `Ending`, leave them safe.

    `arguments` are those of ROS, `--ros-args` and what follows.

    Several of `LOOP_NODES` are joined by a `Rig`. The coils go to zero at once, whatever another
    node or the executor is doing.
    The coil driver, alone in its process, runs in real time where the system grants that; so do
    the nodes of the closed loop, once they are active, in a process without any else.
    A node that has finished, as a player at the end of its recording, ends the process too.
    Returns the exit status: 0 after a signal, 2 where a person must mend an input, 1 otherwise.
    """
    nodes: list[RigNode] = []
    rig = Rig(names) if len(names) > 1 else None
    with Ending(lambda: _zero(nodes), find_launcher()) as ending:
        tell_of_compiling(partial(print, flush=True))
        if names == ['coil_driver']:
            set_realtime_priority_of_all(SAFETY)
        try:
            join(arguments)
        except InputError as error:
            return _refused(error)
        executor = EventsExecutor()
        try:
            with ending.interrupts():  # the first time code is compiled, for minutes
                for name in names:
                    nodes.append(make(name, rig))
                    executor.add_node(nodes[-1])
                _refuse_elsewhere(nodes, arguments or [])
                for node in nodes:
                    _activate(node)
            _settle(names, rig)
            print(READY, *names, flush=True)
            while not (ending.due or any(node.finished for node in nodes)):
                executor.spin_once(timeout_sec=_SPIN_SECONDS)
            return _told_faults(nodes)
        except Stopped:
            return 0
        except InputError as error:
            return _refused(error)
        finally:
            _zero(nodes)
            if rig:
                rig.stop()
            for node in reversed(nodes):
                node.make_safe_and_close()
            for node in reversed(nodes):
                executor.remove_node(node)
                node.destroy_node()
            executor.shutdown()
            rclpy.try_shutdown()


def _refused(error: InputError) -> int:
    """Say what a person must mend; the exit status."""
    print(f'{WORD}{error}', file=sys.stderr)
    return 2


def _refuse_elsewhere(nodes: list[RigNode], arguments: list[str]) -> None:
    """InputError where a parameter file means a node of another namespace by the same name."""
    from microbot_ros.nodes.configuration import refuse_elsewhere

    for word, file in pairwise(arguments):
        if word == '--params-file':
            for node in nodes:
                refuse_elsewhere(file, node.get_name(), node.get_namespace())


def _settle(names: list[str], rig: Rig | None) -> None:
    """All that is slow has been done: from now on every millisecond counts."""
    # What was imported lives for good; a full collection of it would take 40 ms, in a tick.
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_S)
    if rig:
        rig.start()
    if set(LOOP_NODES).issuperset(names):
        set_realtime_priority_of_all(LOOP)


def _told_faults(nodes: list[RigNode]) -> int:
    """Say why nodes have finished; the exit status."""
    faults = [node.fault for node in nodes if node.finished and node.fault]
    for fault in faults:
        print(f'{WORD}{fault}', file=sys.stderr)
    return 1 if faults else 0


def _zero(nodes: list[RigNode]) -> None:
    """Zero the coils, before any other node of the process takes its time; from any thread."""
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
    """`python -m microbot_ros.nodes NODE... [--ros-args ...]`."""
    arguments = sys.argv[1:]
    cut = arguments.index('--ros-args') if '--ros-args' in arguments else len(arguments)
    names, ros = arguments[:cut], arguments[cut:]
    unknown = [name for name in names if name not in NODES]
    if not names or unknown:
        print(f'usage: python -m microbot_ros.nodes NODE... [--ros-args ...]\n'
              f'nodes: {", ".join(NODES)}', file=sys.stderr)
        sys.exit(2)
    leave(run(names, ros))


def script() -> None:
    """The console scripts: `tracker_node --ros-args ...` runs the node it is named after."""
    leave(run([Path(sys.argv[0]).stem.removesuffix('_node')], sys.argv[1:]))
