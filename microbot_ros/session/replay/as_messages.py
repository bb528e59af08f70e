"""A session as the messages of a recording."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.session.mcap.bag import typestore
from microbot_ros.session.mcap.recording import Message, Topic

PARTICLES = '/particles'
COMMAND = '/field/command'
ROTATING = '/field/rotating'
_CLOUD = 'sensor_msgs/msg/PointCloud2'
_VECTOR = 'geometry_msgs/msg/Vector3Stamped'
_TWIST = 'geometry_msgs/msg/TwistStamped'
_FRAME = 'workspace'
_POINT = np.dtype([('id', '<u4')] + [
    (name, '<f4') for name in ('x', 'y', 'theta', 'vx', 'vy', 'sigma')
])
_UINT32, _FLOAT32 = 6, 7  # sensor_msgs/msg/PointField
_SECOND = 1_000_000_000  # nanoseconds, by definition


class SessionMessages:
    """Session that can be read like a recording.

    Its first row is at 1 s of ROS time, since zero means an unknown clock. Tracks are `particles`,
    one message per frame, without velocities. Commands are `field/command` or, for rolling
    particles, `field/rotating`.

    Parameters
    ----------
    session : Session
        The session.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        first = np.concatenate([session.tracks.t[:1], session.commands.t[:1]]).min()
        self._track_ns = _nanoseconds(session.tracks.t - first)
        self._command_ns = _nanoseconds(session.commands.t - first)
        everything = np.concatenate([self._track_ns, self._command_ns])
        self.start_ns, self.end_ns = int(everything.min()), int(everything.max())
        self.topics = {PARTICLES: Topic(_CLOUD, len(np.unique(self._track_ns)))}
        if len(self._command_ns):
            rolls = session.commands.frequency is not None
            self.topics[ROTATING if rolls else COMMAND] = Topic(
                _TWIST if rolls else _VECTOR, len(self._command_ns))

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """Yield messages of `topics` (None: all) from `start_ns` up to `end_ns` [ns] by time.

        As `Recording.messages`; at equal times, commands come before the particles they move.

        Parameters
        ----------
        topics : collection of str or None
            Names of topics; None for all.
        start_ns : int or None
            Beginning [ns]; None for that of the recording.
        end_ns : int or None
            End [ns], excluded; None for that of the recording.

        Yields
        ------
        Message
            The message.
        """
        series = {
            COMMAND: self._commands(), ROTATING: self._rotating(), PARTICLES: self._particles(),
        }
        chosen = [
            stream for name, stream in series.items()
            if name in self.topics and (topics is None or name in topics)
        ]
        low = self.start_ns if start_ns is None else start_ns
        for message in heapq.merge(*chosen, key=lambda message: message.t_ns):
            if end_ns is not None and message.t_ns >= end_ns:
                return
            if message.t_ns >= low:
                yield message

    def times(self, topic: str) -> np.ndarray:
        """Return times (n,) [ns] of the messages of a `topic`, ascending.

        Parameters
        ----------
        topic : str
            Name of the topic.

        Returns
        -------
        ndarray, shape (n,)
            Times [ns].
        """
        return np.unique(self._track_ns) if topic == PARTICLES else self._command_ns

    def _particles(self) -> Iterator[Message]:
        tracks = self._session.tracks
        points = np.zeros(len(tracks.t), _POINT)
        points['id'] = tracks.particle
        points['x'], points['y'] = tracks.position.T
        points['theta'], points['sigma'] = tracks.theta, tracks.sigma
        points['vx'] = points['vy'] = np.nan
        times, starts = np.unique(self._track_ns, return_index=True)
        for t_ns, rows in zip(times.tolist(), np.split(points, starts[1:]), strict=True):
            yield _message(PARTICLES, _CLOUD, t_ns, _cloud(rows, t_ns))

    def _commands(self) -> Iterator[Message]:
        types = typestore().types
        make, vector = types[_VECTOR], types['geometry_msgs/msg/Vector3']
        for t_ns, field in zip(
                self._command_ns.tolist(), self._session.commands.field.tolist(), strict=True):
            yield _message(COMMAND, _VECTOR, t_ns, make(_header(t_ns), vector(*field, 0.0)))

    def _rotating(self) -> Iterator[Message]:
        types, commands = typestore().types, self._session.commands
        make, twist, vector = (types[f'geometry_msgs/msg/{name}']
                               for name in ('TwistStamped', 'Twist', 'Vector3'))
        assert commands.frequency is not None
        rate = 2 * np.pi * commands.frequency / np.maximum(
            np.hypot(*commands.field.T), np.finfo(float).tiny)
        for t_ns, (x, y), w in zip(self._command_ns.tolist(), commands.field.tolist(),
                                   rate.tolist(), strict=True):
            # A sphere on the floor that rotates with ω moves along ω × ẑ.
            yield _message(ROTATING, _TWIST, t_ns, make(_header(t_ns), twist(
                vector(x, y, 0.0), vector(-y * w, x * w, 0.0))))


def _nanoseconds(t: np.ndarray) -> np.ndarray:
    return np.rint(t * _SECOND).astype(np.int64) + _SECOND


def _message(topic: str, msgtype: str, t_ns: int, content: Any) -> Message:
    return Message(topic, msgtype, t_ns, bytes(typestore().serialize_cdr(content, msgtype)))


def _header(t_ns: int) -> Any:
    types = typestore().types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(t_ns, _SECOND))
    return types['std_msgs/msg/Header'](stamp, _FRAME)


def _cloud(points: np.ndarray, t_ns: int) -> Any:
    types = typestore().types
    field = types['sensor_msgs/msg/PointField']
    fields = [
        field(name, 4 * place, _FLOAT32 if place else _UINT32, 1)
        for place, name in enumerate(_POINT.names or ())
    ]
    size = points.dtype.itemsize
    return types[_CLOUD](
        _header(t_ns), 1, len(points), fields, False, size, size * len(points),
        np.frombuffer(points.tobytes(), np.uint8), True,
    )
