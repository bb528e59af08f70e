"""Survey of a session: topics and rates, gaps, missing frames, latency, excitation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Session
from microbot_ros.session.mcap.from_recording import CUT_OFF, session_of, stamp_ns
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.replay.as_messages import SessionMessages
from microbot_ros.session.tables.folder import read_folder

_SAME_LEVEL = 0.02
"""Choice: values closer than this share of the largest are one level."""
_STEP = 1e-3
"""Choice: smaller turns [rad] are read-back noise."""


@dataclass(frozen=True)
class CommandSpread:
    """Spread of the commands over the time that particles were tracked.

    `rows` commands in all; `off_share` of the time without a command; `direction_variance` is
    circular, weighted by time: 0 for one direction, 1 for all alike; `magnitudes_mT` and
    `frequencies_hz` are the levels used; `turns_left` and `turns_right` count changes of
    direction.
    """

    rows: int
    off_share: float
    direction_variance: float
    magnitudes_mT: tuple[float, ...]
    frequencies_hz: tuple[float, ...]
    turns_left: int
    turns_right: int


@dataclass(frozen=True)
class TopicSurvey:
    """One topic: its `name` and `type`, the `count` of its messages, their `rate_hz`.

    `gaps` counts pauses of more than three median intervals; `longest_gap_s` is the longest pause.
    """

    name: str
    type: str
    count: int
    rate_hz: float
    gaps: int
    longest_gap_s: float


@dataclass(frozen=True)
class Survey:
    """Content of `microbot info`; None if unknown.

    `kind` of the session at `path`, 'recording' or 'folder'; `complete` unless cut off;
    `duration_s` from the first message to the last; `topics`; number of `particles`; `frames` with
    tracks and `frames_missing` among them by exposure times; `dropped` by the recorder, by topic;
    `latency_ms` from exposure to the amplifier's acknowledgement; `excitation`; `attachments` by
    name; `metadata` as recorded; `remarks` for people.
    """

    path: str
    kind: str
    complete: bool
    duration_s: float
    topics: tuple[TopicSurvey, ...]
    particles: int | None
    frames: int | None
    frames_missing: int | None
    dropped: dict[str, int]
    latency_ms: dict[str, float] | None
    excitation: CommandSpread | None
    attachments: tuple[str, ...]
    metadata: dict[str, dict[str, str]]
    remarks: tuple[str, ...]


def survey_folder(path: Path) -> tuple[Survey, Session]:
    """Survey a folder of CSV files at `path`.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    tuple[Survey, Session]
        The survey and the session.
    """
    session = read_folder(path)
    return _survey(path, SessionMessages(session), None, session, []), session


def survey_recording(recording: Recording) -> tuple[Survey, Session | None]:
    """Survey a `recording`; the session is None if it cannot be read.

    Raises InputError if it was cut off before its first message.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    tuple[Survey, Session or None]
        The survey and the session, or None.
    """
    if not (recording.complete or recording.end_ns):
        raise InputError(recording.path, 'expected messages, found no complete one')
    remarks = []
    if not recording.complete:
        remarks.append(CUT_OFF)
    session = None
    try:
        session = session_of(recording)
    except InputError as error:
        remarks.append(f'Not a session: {error.expected}.')
    return _survey(recording.path, recording, recording, session, remarks), session


def _survey(
    path: Path, source: Recording | SessionMessages, recording: Recording | None,
    session: Session | None, remarks: list[str],
) -> Survey:
    metadata = recording.metadata() if recording else {}
    frames = spread = None
    if session is not None:
        frames = np.unique(session.tracks.t)
        spread = command_spread(session.commands, frames[0], frames[-1])
        late = session.commands.t[:1] - frames[0]
        if (late > 0).any():
            remarks = [*remarks, f'Nothing was commanded in the first {late[0]:.3g} s.']
    return Survey(
        path=str(path), kind='recording' if recording else 'folder',
        complete=recording is None or recording.complete,
        duration_s=(source.end_ns - source.start_ns) / 1e9,
        topics=tuple(_topic(source, name) for name in sorted(source.topics)),
        particles=None if session is None else len(session.tracks.particles),
        frames=None if frames is None else len(frames),
        frames_missing=None if frames is None else missing_frames(frames),
        dropped={name: int(count) for name, count in metadata.get('dropped', {}).items()},
        latency_ms=_latency(recording) if recording else None, excitation=spread,
        attachments=tuple(recording.attachments()) if recording else (), metadata=metadata,
        remarks=tuple(remarks),
    )


def missing_frames(times: np.ndarray) -> int:
    """Return the number of frames missing between the first and last of `times` [s].

    Parameters
    ----------
    times : ndarray, shape (T,)
        Times [s].

    Returns
    -------
    int
        The number.
    """
    steps = np.diff(times)
    if not len(steps):
        return 0
    return int(np.maximum(np.rint(steps / np.median(steps)) - 1, 0).sum())


def _topic(source: Recording | SessionMessages, name: str) -> TopicSurvey:
    topic = source.topics[name]
    steps = np.diff(source.times(name)) / 1e9
    if not len(steps):
        return TopicSurvey(name, topic.type, topic.count, 0.0, 0, 0.0)
    gaps = int((steps > 3 * np.median(steps)).sum())
    rate = len(steps) / steps.sum() if steps.sum() else 0.0
    return TopicSurvey(name, topic.type, topic.count, float(rate), gaps, float(steps.max()))


def _latency(recording: Recording) -> dict[str, float] | None:
    topic = recording.topic('coil_driver/latency', 'sensor_msgs/msg/TimeReference')
    if topic is None or not recording.topics[topic].count:
        return None
    spent = []
    for message in recording.messages([topic]):
        content = recording.decode(message)
        exposure = content.time_ref.sec * 1_000_000_000 + content.time_ref.nanosec
        spent.append((stamp_ns(content) - exposure) / 1e6)
    p50, p99 = np.percentile(spent, [50, 99])
    return {'p50': float(p50), 'p99': float(p99)}


def command_spread(commands: Commands, start: float, end: float) -> CommandSpread:
    """Return the spread of `commands` between the times `start` and `end` [s].

    Parameters
    ----------
    commands : Commands
        The commands.
    start : float
        Beginning [s].
    end : float
        End [s].

    Returns
    -------
    CommandSpread
        The spread.
    """
    edges = np.clip(np.append(commands.t, np.inf), start, end)
    held = np.diff(edges)
    bx, by = commands.field.T
    magnitude, angle = np.hypot(bx, by), np.arctan2(by, bx)
    frequency = commands.frequency
    on = (magnitude > 0) & (held > 0)
    if frequency is not None:
        on &= frequency != 0
        angle = angle + np.pi * (frequency < 0)
    time_on = held[on].sum()
    resultant = abs((held[on] * np.exp(1j * angle[on])).sum()) / time_on if time_on else 1.0
    turn = np.angle(np.exp(1j * np.diff(angle[on])))
    return CommandSpread(
        rows=len(commands.t), off_share=float(1 - time_on / (end - start)) if end > start else 1.0,
        direction_variance=float(1 - resultant), magnitudes_mT=_levels(magnitude[on] * 1e3),
        frequencies_hz=() if frequency is None else _levels(frequency[on]),
        turns_left=int((turn > _STEP).sum()), turns_right=int((turn < -_STEP).sum()),
    )


def _levels(values: np.ndarray) -> tuple[float, ...]:
    """Return the distinct levels among values, ascending; nearly equal ones are merged."""
    ordered = np.sort(values)
    width = _SAME_LEVEL * np.abs(ordered).max(initial=0.0)
    levels = []
    while len(ordered):
        size = np.searchsorted(ordered, ordered[0] + width, side='right')
        levels.append(float(f'{np.median(ordered[:size]):.4g}'))
        ordered = ordered[size:]
    return tuple(levels)
