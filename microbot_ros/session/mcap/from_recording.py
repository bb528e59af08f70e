"""A session from a recording: topics that become tracks and commands, and their clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from microbot_ros.common import strict_yaml
from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.session.mcap.cloud import cloud_points
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.tables.folder import SessionFile
from microbot_ros.session.tables.plausibility import check_session

CUT_OFF = ('The recording was cut off: data after the last complete chunk are lost; `microbot '
           'info --repair` writes its index.')
_FARTHEST_STAMP = 60_000_000_000
"""Choice: largest difference [ns] of exposure and receipt on one clock."""


def session_of(recording: Recording) -> Session:
    """Return the session in a `recording`, with times in seconds since the first message.

    Tracks come from `particles` at the time of exposure (`header.stamp`); rows without a position
    are gaps. Commands come from `field/command` and, for rolling particles, `field/rotating`, at
    the time of receipt: the stamp of a command is the exposure it answers, not the time it takes
    effect. Where `coils/applied` shows that the gate passed no current, the command is zero. A
    recording without commands gives `field/applied` instead, or none. Conditions come from the
    recording's metadata `session`. Raises InputError without tracks, or if a topic has unexpected
    content.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    Session
        The session.
    """
    particles = recording.topic('particles', 'sensor_msgs/msg/PointCloud2')
    if particles is None:
        raise InputError(recording.path, 'expected a topic particles')
    series = [found for name in SERIES if (found := _find_series(recording, name))]
    if any(one.name in _COMMANDS for one in series):
        series = [one for one in series if one.name != 'field/applied']
    by_topic = {one.topic: one for one in series}
    sightings = _Sightings(recording, particles)
    for message in recording.messages([particles, *by_topic]):
        content = recording.decode(message)
        if message.topic == particles:
            sightings.add(message.t_ns, content)
        else:
            by_topic[message.topic].add(message.t_ns, content)
    commands = commands_of({one.name: one.arrays(recording) for one in series})
    conditions = _conditions(recording, commands.frequency is not None)
    session = Session(sightings.tracks(), commands, conditions, recording.path.resolve().stem,
                      remarks=() if recording.complete else (CUT_OFF,))
    check_session(recording.path, session)
    return session


class _Sightings:
    """The clouds of `particles`, checked as they are added."""

    def __init__(self, recording: Recording, topic: str) -> None:
        self._recording, self._topic = recording, topic
        self._stamps: list[np.ndarray] = []
        self._clouds: list[dict[str, np.ndarray]] = []
        self._last = -1

    def add(self, t_ns: int, content: Any) -> None:
        stamp = stamp_ns(content)
        if stamp <= self._last or abs(stamp - t_ns) > _FARTHEST_STAMP:
            problem = 'to ascend' if stamp <= self._last else "on the recorder's clock"
            at = (t_ns - self._recording.start_ns) / 1e9
            self._refuse(f'expected stamps {problem}, at {at:.3f} s')
        self._last = stamp
        self._clouds.append(cloud_points(content, self._recording.path, self._topic))
        self._stamps.append(np.full(len(self._clouds[-1]['id']), stamp))

    def tracks(self) -> Tracks:
        if not self._clouds:
            self._refuse('expected positions of particles, found none')
        columns = {
            name: np.concatenate([cloud[name] for cloud in self._clouds])
            for name in self._clouds[0]
        }
        position = np.column_stack([columns['x'], columns['y']])
        seen = np.isfinite(position).all(axis=1)
        if not seen.any():
            self._refuse('expected positions of particles, found none')
        t = (np.concatenate(self._stamps) - self._recording.start_ns) / 1e9
        particle = columns['id'].astype(np.int64)
        order = np.lexsort((particle, t))
        order = order[seen[order]]
        if np.any((np.diff(t[order]) == 0) & (np.diff(particle[order]) == 0)):
            self._refuse('expected a particle once in a message')
        return Tracks(
            t[order], particle[order], position[order], columns['theta'][order],
            columns['sigma'][order],
        )

    def _refuse(self, problem: str) -> NoReturn:
        raise InputError(self._recording.path, f'{self._topic}: {problem}')


@dataclass
class _Series:
    """Values of one topic over time."""

    name: str
    topic: str
    value: Callable[[Any], tuple[float, ...]]
    t_ns: list[int] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, t_ns: int, content: Any) -> None:
        self.t_ns.append(t_ns)
        self.values.append(self.value(content))

    def arrays(self, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        """Return times of receipt (K,) [s] and values (K, n)."""
        values = np.array(self.values, dtype=float)
        if not np.isfinite(values).all():
            raise InputError(recording.path, f'{self.topic}: expected finite values')
        return (np.array(self.t_ns) - recording.start_ns) / 1e9, values


def _find_series(recording: Recording, name: str) -> _Series | None:
    msgtype, value = SERIES[name]
    topic = recording.topic(name, msgtype)
    if topic is None or not recording.topics[topic].count:
        return None
    return _Series(name, topic, value)


def commands_of(series: dict[str, tuple[np.ndarray, np.ndarray]]) -> Commands:
    """Return the commands in `series`: topic → times (K,) [s] and values (K, n).

    `field/command` (K, 2) [T] is a field that stands, `field/rotating` (K, 3) [T, T, Hz] one that
    rotates, and `coils/applied` (K, 1) is 1 where any current flowed. `field/rotation` (K, 1) [Hz]
    in recordings of earlier versions makes `field/command` rotate. Without any command,
    `field/applied` (K, 2) [T] takes its place.

    Parameters
    ----------
    series : dict[str, tuple[ndarray, ndarray]]
        Times and values by topic.

    Returns
    -------
    Commands
        The commands.
    """
    commands = [(times, np.pad(values, [(0, 0), (0, 3 - values.shape[1])]))
                for name in _COMMANDS if name in series for times, values in [series[name]]]
    if not commands:
        nothing = np.empty(0), np.empty((0, 2))
        return changes(*series.get('field/applied', nothing), None)
    t = np.unique(np.concatenate([times for times, _ in series.values()]))
    times, rows = (np.concatenate(parts) for parts in zip(*commands, strict=True))
    order = np.argsort(times, kind='stable')
    commanded = _held(t, times[order], rows[order])
    if 'coils/applied' in series:
        commanded = commanded * _held(t, *series['coils/applied'])
    field, frequency = commanded[:, :2], commanded[:, 2]
    if 'field/rotation' in series:
        # No field turns nothing, whatever rate was last told.
        frequency = _held(t, *series['field/rotation'])[:, 0] * field.any(axis=1)
    rolls = {'field/rotating', 'field/rotation'} & series.keys()
    return changes(t, field, frequency if rolls else None)


def _held(t: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return each value held until the next; zero before the first."""
    return np.vstack([np.zeros(values.shape[1]), values])[
        np.searchsorted(times, t, side='right')]


def changes(t: np.ndarray, b: np.ndarray, frequency: np.ndarray | None,
            tilt: np.ndarray | None = None) -> Commands:
    """Return commands of fields `b` (K, 2) [T] without rows that repeat the previous one.

    `t` (K,) [s] ascends; `frequency` (K,) [Hz] and `tilt` (K,) [rad], or None.

    Parameters
    ----------
    t : ndarray, shape (K,)
        Times [s].
    b : ndarray, shape (K, 2)
        Fields [T].
    frequency : ndarray, shape (K,), or None
        Frequencies [Hz], or None.
    tilt : ndarray, shape (K,), or None
        Tilts of the axis [rad], or None.

    Returns
    -------
    Commands
        The commands.
    """
    state = np.column_stack([b, *(one for one in (frequency, tilt) if one is not None)])
    new = np.append(True, (np.diff(state, axis=0) != 0).any(axis=1))[:len(t)]
    return Commands(t[new], b[new], *(None if one is None else one[new]
                                      for one in (frequency, tilt)))


def _conditions(recording: Recording, rolling: bool) -> Conditions:
    try:
        # Values of metadata in MCAP are texts.
        entries = {key: strict_yaml.load(text)[1]
                   for key, text in recording.metadata().get('session', {}).items()}
        return SessionFile.from_content(entries).conditions(rolling)
    except ValueError as error:
        raise InputError(recording.path, f"metadata 'session': {error}") from None


def stamp_ns(content: Any) -> int:
    """Return the stamp [ns] in the header of a decoded message `content`.

    Parameters
    ----------
    content : object
        The decoded message.

    Returns
    -------
    int
        Stamp [ns].
    """
    stamp = content.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _vector(content: Any) -> tuple[float, float]:
    return content.vector.x, content.vector.y


def _magnetic(content: Any) -> tuple[float, float]:
    return content.magnetic_field.x, content.magnetic_field.y


def _any_current(content: Any) -> tuple[bool]:
    return (bool(np.any(content.effort)),)


def _frequency(vector: Any) -> float:
    return float(np.hypot(vector.x, vector.y)) / (2 * np.pi)


def _rotating(content: Any) -> tuple[float, float, float]:
    field, rate = content.twist.linear, content.twist.angular
    # A sphere on the floor that rotates with ω moves along ω × ẑ, here against the field.
    back = field.x * rate.y - field.y * rate.x < 0
    return field.x, field.y, -_frequency(rate) if back else _frequency(rate)


_COMMANDS = ('field/command', 'field/rotating')

SERIES: dict[str, tuple[str, Callable[[Any], tuple[float, ...]]]] = {
    'field/command': ('geometry_msgs/msg/Vector3Stamped', _vector),
    'field/rotating': ('geometry_msgs/msg/TwistStamped', _rotating),
    'field/applied': ('sensor_msgs/msg/MagneticField', _magnetic),
    'field/rotation': ('geometry_msgs/msg/Vector3Stamped', lambda m: (_frequency(m.vector),)),
    'coils/applied': ('sensor_msgs/msg/JointState', _any_current),
}
"""Topic → type of its messages and the function that returns the values of one."""
