"""Recent past of a running graph as a session, to analyse it while it runs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from sensor_msgs.msg import JointState, MagneticField, PointCloud2

from microbot_ros.common import units
from microbot_ros.common.records import Conditions, Session, Tracks
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.session.mcap.from_recording import SERIES, commands_of

_LIVE_SECONDS = 1.0
"""Difference [s] between a stamp and this machine's clock up to which messages count as live.
Choice: longer than any delay of a rig, shorter than the age of any recording."""

_BACKLOG_SECONDS = 0.5
"""Time [s] to receive waiting messages. Choice: messages of minutes take much less."""


_SAME_FIELD = 3e-5
"""Fields [T] closer than this count as equal. Choice: above the error of a field that is read
back; half would store noise, twice would miss small steps."""


class LiveSessionBuffer:
    """Buffer of `particles`, the commanded field, its rotation, and whether the gate passed it.

    Parameters
    ----------
    client : GraphClient
        Client of the graph.
    seconds : float
        Time that is kept [s].
    applied : bool
        Whether to keep the field that is read back in place of the commanded one, if it differs
        from the last. It has no effect for rollers, whose field rotates while they do what is
        commanded.
    """

    def __init__(self, client: GraphClient, seconds: float, applied: bool = False) -> None:
        self._seconds = seconds
        self._frames: deque[tuple[float, np.ndarray]] = deque()
        self._commands: dict[str, deque[tuple[float, ...]]] = {}
        self._client = client
        subscribe = client.node.create_subscription
        subscribe(PointCloud2, 'particles', self._on_particles, 200)
        if applied and self.conditions().propulsion != 'rolling':
            subscribe(MagneticField, 'field/applied', self._take_applied, 200)
            return
        for topic, kind in (('field/command', Vector3Stamped), ('field/rotating', TwistStamped),
                            ('coils/applied', JointState)):
            subscribe(kind, topic, self._taker(topic, SERIES[topic][1]), 200)

    def conditions(self) -> Conditions:
        """Return the particles and the fluid according to the model node.

        Returns
        -------
        Conditions
            The conditions.
        """
        told = self._client.get('model', 'propulsion', 'radius_um', 'viscosity_mPa_s',
                                'temperature_K', 'reference_field_mT', 'height_um')
        return Conditions(
            propulsion=told['propulsion'],
            **{name: float(units.to_si(key, told[key])) or None for name, key in (
                ('radius', 'radius_um'), ('viscosity', 'viscosity_mPa_s'),
                ('temperature', 'temperature_K'), ('reference_field', 'reference_field_mT'),
                ('height', 'height_um'))})

    @property
    def span(self) -> float:
        """Time that has been collected [s]."""
        return self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0

    @property
    def begin(self) -> float:
        """Stamp [s] of the first frame that was collected; NaN without any."""
        return self._frames[0][0] if self._frames else math.nan

    def forget(self) -> None:
        """Restart the collection now, keeping the commands still in force."""
        self._client.spin(_BACKLOG_SECONDS)
        self._frames.clear()

    def go_on(self) -> None:
        """Keep only the last frame and the commands since; the collection continues from there."""
        while len(self._frames) > 1:
            self._frames.popleft()

    def session(self) -> Session:
        """Return the collection.

        Returns
        -------
        Session
            Session with times [s] from its first frame.
        """
        origin = self._frames[0][0] if self._frames else 0.0
        empty = np.empty(0, PARTICLE)
        points = np.concatenate([empty, *(frame for _, frame in self._frames)])
        t = np.repeat([t - origin for t, _ in self._frames], [len(f) for _, f in self._frames])
        series = {topic: np.array(rows) for topic, rows in self._commands.items() if rows}
        return Session(
            Tracks(t, points['id'].astype(int),
                   np.stack([points['x'], points['y']], axis=1).astype(float),
                   points['theta'].astype(float), points['sigma'].astype(float)),
            commands_of({topic: (rows[:, 0] - origin, rows[:, 1:])
                         for topic, rows in series.items()}),
            self.conditions(), 'live')

    def _on_particles(self, message: PointCloud2) -> None:
        t = messages.to_seconds(message.header.stamp)
        if self._frames and t <= self._frames[-1][0]:
            if self._frames[-1][0] - t < _LIVE_SECONDS:
                return
            # A replay begins again.
            self._frames.clear()
            for rows in self._commands.values():
                rows.clear()
        self._frames.append((t, messages.points(message, PARTICLE)))
        while self._frames[-1][0] - self._frames[0][0] > self._seconds:
            self._frames.popleft()
        # The last command before the first frame still holds there.
        for rows in self._commands.values():
            while len(rows) > 1 and rows[1][0] < self._frames[0][0]:
                rows.popleft()

    def _take_applied(self, message: MagneticField) -> None:
        # Its stamp is the time of the reading, however late the message arrives.
        field = message.magnetic_field.x, message.magnetic_field.y
        rows = self._commands.setdefault('field/command', deque())
        if not rows or math.dist(field, rows[-1][1:]) >= _SAME_FIELD:
            _append(rows, messages.to_seconds(message.header.stamp), field)

    def _taker(self, topic: str,
               value: Callable[[Any], tuple[float, ...]]) -> Callable[..., None]:
        rows = self._commands[topic] = deque()

        def take(message: Any) -> None:
            # A command acts when it arrives; its stamp is the exposure that it answers. In a
            # replay this machine's clock is meaningless, and the stamp is the best estimate.
            t = messages.to_seconds(message.header.stamp)
            now = messages.to_seconds(self._client.node.get_clock().now().to_msg())
            _append(rows, now if abs(now - t) < _LIVE_SECONDS else t, value(message))
        return take


def _append(rows: deque[tuple[float, ...]], t: float, value: tuple[float, ...]) -> None:
    if not rows or t > rows[-1][0]:
        rows.append((t, *value))
