"""The recent past of a running graph as a session, for looking at it while it goes on."""

from __future__ import annotations

from collections import deque

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import PointCloud2

from microbot_ros import units
from microbot_ros.nodes import messages
from microbot_ros.nodes.remote import Remote
from microbot_ros.records import Commands, Conditions, Session, Tracks

_LIVE_SECONDS = 1.0


class Collector:
    """Keeps the last `seconds` of `particles` and `field/command` of a graph."""

    def __init__(self, remote: Remote, seconds: float) -> None:
        self._seconds = seconds
        self._frames: deque[tuple[float, np.ndarray]] = deque()
        self._commands: deque[tuple[float, float, float]] = deque()
        self._remote = remote
        remote.node.create_subscription(PointCloud2, 'particles', self._on_particles, 200)
        remote.node.create_subscription(Vector3Stamped, 'field/command', self._on_command, 200)

    def conditions(self) -> Conditions:
        """What the model node was told of particles and fluid."""
        told = self._remote.get('model', 'propulsion', 'radius_um', 'viscosity_mPa_s',
                                'temperature_K', 'reference_field_mT')
        return Conditions(
            propulsion=told['propulsion'],
            **{name: float(units.to_si(key, told[key])) for name, key in (
                ('radius', 'radius_um'), ('viscosity', 'viscosity_mPa_s'),
                ('temperature', 'temperature_K'), ('reference_field', 'reference_field_mT'))})

    @property
    def span(self) -> float:
        """How many seconds have been collected."""
        return self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0

    def session(self) -> Session:
        """What was collected; times [s] count from the first frame of it."""
        origin = self._frames[0][0] if self._frames else 0.0
        empty = np.empty(0, messages.PARTICLE)
        points = np.concatenate([empty, *(frame for _, frame in self._frames)])
        t = np.repeat([t - origin for t, _ in self._frames], [len(f) for _, f in self._frames])
        commands = np.array(self._commands).reshape(-1, 3)
        return Session(
            Tracks(t, points['id'].astype(int),
                   np.stack([points['x'], points['y']], axis=1).astype(float),
                   points['theta'].astype(float), points['sigma'].astype(float)),
            Commands(commands[:, 0] - origin, commands[:, 1:]), self.conditions(), 'live')

    def _on_particles(self, message: PointCloud2) -> None:
        t = messages.to_seconds(message.header.stamp)
        if self._frames and t <= self._frames[-1][0]:
            return
        self._frames.append((t, messages.points(message, messages.PARTICLE)))
        while self._frames[-1][0] - self._frames[0][0] > self._seconds:
            self._frames.popleft()
        # The last command before the first frame still holds there.
        while len(self._commands) > 1 and self._commands[1][0] < self._frames[0][0]:
            self._commands.popleft()

    def _on_command(self, message: Vector3Stamped) -> None:
        # A command acts when it arrives; its stamp is the exposure that it answers. In a replay
        # the clock of this machine says nothing, and the stamp is the best there is.
        t = messages.to_seconds(message.header.stamp)
        now = messages.to_seconds(self._remote.node.get_clock().now().to_msg())
        t = now if abs(now - t) < _LIVE_SECONDS else t
        if not self._commands or t > self._commands[-1][0]:
            self._commands.append((t, message.vector.x, message.vector.y))
