"""What is in a session: topics and rates, gaps, frames that are missing, latency, excitation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.records import Session
from microbot_ros.session.as_messages import SessionMessages
from microbot_ros.session.excitation import Excitation, excitation
from microbot_ros.session.folder import read_folder
from microbot_ros.session.from_recording import session_of, stamp_ns
from microbot_ros.session.recording import Recording


@dataclass(frozen=True)
class TopicSurvey:
    """One topic; a gap is a pause of more than three of its median intervals."""

    name: str
    type: str
    count: int
    rate_hz: float
    gaps: int
    longest_gap_s: float


@dataclass(frozen=True)
class Survey:
    """What `microbot info` tells. None where a session does not know.

    `frames` with tracks and `frames_missing` among them are judged by the times of exposure;
    `dropped` is what the recorder had to give up, by topic; `latency_ms` runs from exposure to
    the amplifier's acknowledgement.
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
    excitation: Excitation | None
    attachments: tuple[str, ...]
    metadata: dict[str, dict[str, str]]
    remarks: tuple[str, ...]


def survey_folder(path: Path) -> tuple[Survey, Session]:
    """A look at a folder of CSV files."""
    session = read_folder(path)
    return _survey(path, SessionMessages(session), None, session, []), session


def survey_recording(recording: Recording) -> tuple[Survey, Session | None]:
    """A look at a recording; None for a session that cannot be read out of it."""
    remarks = []
    if not recording.complete:
        remarks.append('The recording was cut off; --repair writes its index.')
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
        spread = excitation(session.commands, frames[0], frames[-1])
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
        remarks=(*remarks, *(spread.sentences() if spread else ())),
    )


def missing_frames(times: np.ndarray) -> int:
    """Frames that an even frame rate would have had between the first and the last of them."""
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
