"""A session out of a recording: which topics become tracks and commands, on which clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pydantic

from microbot_ros.errors import InputError
from microbot_ros.records import Commands, Conditions, Session, Tracks
from microbot_ros.session.cloud import cloud_points
from microbot_ros.session.folder import SessionFile
from microbot_ros.session.recording import Recording

_FARTHEST_STAMP = 60_000_000_000
"""Exposure and receipt lie within this [ns] of each other, or they are not on one clock."""


def session_of(recording: Recording) -> Session:
    """The session in a recording, its times in seconds since the first message.

    Tracks come from `particles` at the time of exposure (`header.stamp`); rows that hold no
    position are gaps. Commands come from `field/command` and, where particles roll,
    `field/rotation`, at the time of receipt: the stamp of a command is the exposure it answers,
    not the moment it takes force. Where `coils/applied` shows that the gate let no current
    through, the command is zero. A recording without `field/command` gives `field/applied`
    instead, or no commands. Conditions come from the recording's metadata named `session`.
    """
    tracks = _tracks(recording)
    commands = _commands(recording)
    conditions = _conditions(recording, commands.frequency is not None)
    return Session(tracks, commands, conditions, recording.path.resolve().stem)


def _tracks(recording: Recording) -> Tracks:
    topic = recording.topic('particles', 'sensor_msgs/msg/PointCloud2')
    if topic is None:
        raise InputError(recording.path, 'expected a topic particles')
    stamps, clouds, last = [], [], -1
    for message in recording.messages([topic]):
        content = recording.decode(message)
        stamp = stamp_ns(content)
        if stamp <= last or abs(stamp - message.t_ns) > _FARTHEST_STAMP:
            problem = 'to ascend' if stamp <= last else "on the recorder's clock"
            at = (message.t_ns - recording.start_ns) / 1e9
            raise InputError(recording.path, f'{topic}: expected stamps {problem}, at {at:.3f} s')
        last = stamp
        clouds.append(cloud_points(content, recording.path, topic))
        stamps.append(np.full(len(clouds[-1]['id']), stamp))
    columns = {
        name: np.concatenate([cloud[name] for cloud in clouds])
        for name in ('id', 'x', 'y', 'theta', 'sigma')
    } if clouds else {}
    if not clouds or not (seen := np.isfinite(columns['x']) & np.isfinite(columns['y'])).any():
        raise InputError(recording.path, f'{topic}: expected positions of particles, found none')
    t = (np.concatenate(stamps)[seen] - recording.start_ns) / 1e9
    columns = {name: column[seen] for name, column in columns.items()}
    particle = columns['id'].astype(np.int64)
    order = np.lexsort((particle, t))
    if np.any((np.diff(t[order]) == 0) & (np.diff(particle[order]) == 0)):
        raise InputError(recording.path, f'{topic}: expected a particle once in a message')
    position = np.column_stack([columns['x'], columns['y']])
    return Tracks(
        t[order], particle[order], position[order], columns['theta'][order],
        columns['sigma'][order],
    )


def _commands(recording: Recording) -> Commands:
    wanted = _series(recording, 'field/command', 'geometry_msgs/msg/Vector3Stamped', _vector)
    if wanted is None:
        applied = _series(recording, 'field/applied', 'sensor_msgs/msg/MagneticField', _magnetic)
        if applied is None:
            return Commands(np.empty(0), np.empty((0, 2)))
        return changes(*applied, None)
    times, field = wanted
    gate = _series(recording, 'coils/applied', 'sensor_msgs/msg/JointState', _any_current)
    turning = _series(recording, 'field/rotation', 'geometry_msgs/msg/Vector3Stamped', _frequency)
    t = np.unique(np.concatenate([series[0] for series in (wanted, gate, turning) if series]))
    field = _held(t, times, field)
    if gate is not None:
        field = field * _held(t, *gate)
    if turning is None:
        return changes(t, field, None)
    # No field turns nothing, whatever rate was last told.
    return changes(t, field, _held(t, *turning)[:, 0] * field.any(axis=1))


def _series(
    recording: Recording, name: str, msgtype: str, value: Any,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Times of receipt (K,) [s] and values (K, n) of a topic; None where it holds nothing."""
    topic = recording.topic(name, msgtype)
    if topic is None:
        return None
    found = [(m.t_ns, value(recording.decode(m))) for m in recording.messages([topic])]
    if not found:
        return None
    t = (np.array([t_ns for t_ns, _ in found]) - recording.start_ns) / 1e9
    values = np.array([content for _, content in found], dtype=float)
    if not np.isfinite(values).all():
        raise InputError(recording.path, f'{topic}: expected finite values')
    return t, values


def _held(t: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Each value held until the next; zero before the first."""
    return np.vstack([np.zeros(values.shape[1]), values])[
        np.searchsorted(times, t, side='right')]


def changes(t: np.ndarray, field: np.ndarray, frequency: np.ndarray | None) -> Commands:
    """Commands (K', …) without the rows of (K, …) that repeat the one before."""
    state = field if frequency is None else np.column_stack([field, frequency])
    new = np.append(True, (np.diff(state, axis=0) != 0).any(axis=1))
    return Commands(t[new], field[new], None if frequency is None else frequency[new])


def _conditions(recording: Recording, rolling: bool) -> Conditions:
    try:
        entries = recording.metadata().get('session', {})
        return SessionFile.model_validate(entries).conditions(rolling)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        key = '.'.join(map(str, first['loc']))
        problem = f"metadata 'session', key '{key}': {first['msg']}"
        raise InputError(recording.path, problem) from None


def stamp_ns(content: Any) -> int:
    """The stamp of a decoded message's header [ns]."""
    stamp = content.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _vector(content: Any) -> tuple[float, float]:
    return content.vector.x, content.vector.y


def _magnetic(content: Any) -> tuple[float, float]:
    return content.magnetic_field.x, content.magnetic_field.y


def _any_current(content: Any) -> tuple[bool]:
    return (bool(np.any(content.effort)),)


def _frequency(content: Any) -> tuple[float]:
    vector = content.vector
    return (float(np.hypot(vector.x, vector.y)) / (2 * np.pi),)
