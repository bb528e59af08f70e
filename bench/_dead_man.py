"""How long the coils outlive the last good command, by the emulated amplifier's own log.

The nodes are the real ones, a process each, over a real middleware and a pseudo-terminal. They are
forked from a server that has imported everything, which makes a killed one return within a second.
"""

from __future__ import annotations

import multiprocessing as mp
import os
import random
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import Joy
from std_srvs.srv import SetBool

from bench._emulator import FULL_SCALE_A, EmulatorProcess
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

NODES = ('camera', 'tracker', 'model', 'controller', 'coil_driver')
_FORKING = mp.get_context('forkserver')
_FRAME_RATE_HZ = 30.0
_HEARD_S, _SILENT_S = 0.06, 0.04
_DEADLINE_S = 60.0
_JOY_S = 0.05


class _Rig:
    """Five nodes that drive the amplifier; what was ended is started again by `drive`."""

    def __init__(self, folder: Path, board: EmulatorProcess, client: GraphClient) -> None:
        self.board = board
        self._parameters = _parameters(folder, board)
        self._client = client
        self._nodes: dict[str, BaseProcess] = {}
        self._commands: deque[float] = deque(maxlen=100)
        self._offset_s = time.time() - time.monotonic()
        self._joystick = client.node.create_publisher(Joy, 'joy', 1)
        self._stick = 0.0
        """Deflection of a joystick that lives; 0 where there is none."""
        self._moved_s = 0.0
        self._arming = client.node.create_client(SetBool, 'coil_driver/arm')
        client.node.create_subscription(
            Vector3Stamped, 'field/command', self._on_command, 50)

    def _on_command(self, message: Vector3Stamped, info: dict[str, Any]) -> None:
        if message.vector.x or message.vector.y:
            self._commands.append(info['source_timestamp'] * 1e-9 - self._offset_s)

    def drive(self) -> None:
        """Make sure that every node runs, and that currents flow by command and go on to."""
        deadline = time.monotonic() + _DEADLINE_S
        self._start_missing()
        while not (self._armed() and self._within(1.0, self._driving)):
            if time.monotonic() > deadline:
                raise TimeoutError('the coils were never driven')
            self._spin(0.02)
            self._start_missing()  # one that was told to end may have taken until now
        self._spin(random.uniform(0.02, 0.06))
        if not self._driving():
            self.drive()

    def _start_missing(self) -> None:
        for name in NODES:
            if (node := self._nodes.get(name)) is None or not node.is_alive():
                if node is not None and node.exitcode not in (-signal.SIGKILL, 0):
                    raise RuntimeError(f'{name} ended by itself, status {node.exitcode}')
                self._nodes[name] = _FORKING.Process(
                    target=_run_node, args=(name, self._parameters), daemon=True)
                self._nodes[name].start()

    def _driving(self) -> bool:
        """Whether currents flow and we hear the commands, as the driver does."""
        heard = bool(self._commands) and time.monotonic() - self._commands[-1] < _HEARD_S
        return heard and not self.board.zero

    def _armed(self) -> bool:
        # Not `GraphClient.arm`, which would wait long for an answer of a driver that was killed.
        answer = self._arming.call_async(SetBool.Request(data=True))
        armed = self._within(1.0, answer.done) and bool(answer.result().success)
        if armed and self._stick and not self._driving():
            # A stick that is deflected at arming moves nothing until it was centred once.
            self._move_stick(0.0)
            self._client.spin(_JOY_S)
        return armed

    def spent_s(self, end: Callable[[], None], deaf: bool) -> float:
        """From the last good command to zero, when `end` happens now.

        Where the end leaves nobody who takes commands, those that come later are not good.
        """
        ended = time.monotonic()
        end()
        if not self._within(_DEADLINE_S, lambda: self.board.zero):
            raise TimeoutError('the coils never came to zero')
        zeroed = next(t for t, zero in self.board.changes if zero and t > ended)
        self._catch_up(zeroed)
        last = ended if deaf else zeroed
        return zeroed - max(t for t in self._commands if t < last)

    def _catch_up(self, moment: float) -> None:
        """Hear every command that was sent before a moment."""
        heard = -1.0
        while heard < self._commands[-1] < moment:
            heard = self._commands[-1]
            self._client.spin(_SILENT_S)

    def _within(self, seconds: float, true: Callable[[], bool]) -> bool:
        """Whether something comes true in time."""
        deadline = time.monotonic() + seconds
        while not true():
            if time.monotonic() > deadline:
                return False
            self._spin(0.002)
        return True

    def _spin(self, seconds: float) -> None:
        if self._stick and time.monotonic() - self._moved_s >= _JOY_S:
            self._move_stick(self._stick)
        self._client.spin(seconds)

    def _move_stick(self, deflection: float) -> None:
        self._moved_s = time.monotonic()
        stick = Joy(axes=[deflection, 0.0])
        stick.header.stamp = self._client.node.get_clock().now().to_msg()
        self._joystick.publish(stick)

    def steer_by_hand(self, deflection: float) -> None:
        """Let a joystick drive, or else the controller that needs nobody."""
        self._stick = deflection
        self._client.set('controller', controller='teleop' if deflection else 'open_loop')

    def joystick_dies_s(self) -> float:
        """From the last word of a joystick that is deflected to zero."""
        self.drive()
        deflection, self._stick = self._stick, 0.0
        zeroed = self.board.zero_after(self._moved_s, _DEADLINE_S)
        self._stick = deflection
        return zeroed - self._moved_s

    def send(self, name: str, number: int) -> None:
        """Send a signal to a node."""
        node = self._nodes[name]
        assert node.pid is not None
        os.kill(node.pid, number)
        if number == signal.SIGKILL:
            node.join()

    def end(self) -> None:
        """Leave nothing running."""
        for node in self._nodes.values():
            node.kill()
            node.join()


def _run_node(name: str, parameters: Path) -> None:
    """In a process of its own: a node until its end or that of the server it came from."""
    from microbot_ros.nodes.base.participant import leave
    from microbot_ros.nodes.client.graph import PARENT
    from microbot_ros.nodes.process import run
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(1, 2)
    os.environ[PARENT] = str(os.getppid())
    leave(run(name, ['--ros-args', '--params-file', str(parameters)]))


def _parameters(folder: Path, board: EmulatorProcess) -> Path:
    """A film of three particles that rest, and a controller that drives one way."""
    scope = Microscope(MicroscopeSettings(), seed=3)
    place = np.array([[-60.0, 20.0], [10.0, -40.0], [70.0, 30.0]]) * 1e-6
    for frame in range(30):
        picture = scope.render(place, np.array([0.3, 1.0, 2.0]), frame / _FRAME_RATE_HZ)
        cv2.imwrite(str(folder / f'{frame:03d}.png'), picture)
    nodes: dict[str, dict[str, Any]] = {
        'camera': {'source': str(folder / '*.png'), 'frame_rate_hz': _FRAME_RATE_HZ, 'loop': True},
        'tracker': {'pixel_size_um': 0.45}, 'model': {},
        'controller': {'controller': 'open_loop', 'open_loop.durations_s': [3600.0],
                       'open_loop.directions_deg': [45.0]},
        'coil_driver': {'port': str(board.url), 'full_scale_A': FULL_SCALE_A}}
    path = folder / 'parameters.yaml'
    path.write_text(yaml.safe_dump(
        {node: {'ros__parameters': values} for node, values in nodes.items()}))
    return path


def _ends(rig: _Rig) -> dict[str, tuple[Callable[[], None], Callable[[], None], bool]]:
    """What ends it, what mends that, and whether commands that come later go nowhere."""
    def nothing() -> None: ...

    ends: dict[str, tuple[Callable[[], None], Callable[[], None], bool]] = {
        f'kill -9 of {name}': (partial(rig.send, name, signal.SIGKILL), nothing,
                               name == 'coil_driver') for name in NODES}
    for what, name in (('a stopped driver', 'coil_driver'), ('a hung controller', 'controller')):
        ends[what] = (partial(rig.send, name, signal.SIGSTOP),
                      partial(rig.send, name, signal.SIGCONT), name == 'coil_driver')
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        ends[f'{number.name} to the driver'] = (
            partial(rig.send, 'coil_driver', number), nothing, True)
    return {**ends, 'an unplugged line': (partial(rig.board.fault, 'unplug+0.2'), nothing, True)}


def spent_s(tries: int) -> dict[str, list[float]]:
    """For each way to end, the times from the last good command to zero [s]."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(215 + os.getpid() % 17))  # nobody else's graph
    _FORKING.set_forkserver_preload([
        'cv2', 'numba', 'scipy.optimize', 'scipy.spatial', 'microbot_ros.nodes.process',
        *(f'microbot_ros.nodes.{name}' for name in NODES)])
    random.seed(2)
    spent: dict[str, list[float]] = {}
    with (tempfile.TemporaryDirectory() as folder,
          EmulatorProcess(Path(folder)) as board, GraphClient('bench') as client):
        rig = _Rig(Path(folder), board, client)
        try:
            for name, (end, mend, deaf) in _ends(rig).items():
                for _ in range(tries):
                    rig.drive()
                    spent.setdefault(name, []).append(rig.spent_s(end, deaf))
                    mend()
            rig.drive()
            rig.steer_by_hand(1.0)
            spent['a dead joystick'] = [rig.joystick_dies_s() for _ in range(tries)]
        finally:
            rig.end()
    return spent
