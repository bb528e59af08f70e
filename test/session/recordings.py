"""Sessions and recordings to test on."""

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import numpy as np

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.session.mcap.bag import typestore
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Message, Topic
from microbot_ros.session.replay.as_messages import SessionMessages

IMAGE = 'sensor_msgs/msg/Image'
VECTOR = 'geometry_msgs/msg/Vector3Stamped'


class Listed:
    """A source of listed messages."""

    def __init__(self, messages: Iterable[Message]) -> None:
        self.listed = sorted(messages, key=lambda m: m.t_ns)
        self.topics = {m.topic: Topic(m.type, 1) for m in messages}
        self.start_ns, self.end_ns = self.listed[0].t_ns, self.listed[-1].t_ns

    def messages(self, topics: Collection[str] | None = None, start_ns: int | None = None,
                 end_ns: int | None = None) -> Iterator[Message]:
        return iter([m for m in self.listed if (topics is None or m.topic in topics)
                     and (start_ns or 0) <= m.t_ns < (end_ns or 2**63)])


def small_session(seed: int = 0, frames: int = 120, rolling: bool = False) -> Session:
    """Two particles at 60 frames/s, one of them missing now and then, and ten commands."""
    rng = np.random.default_rng(seed)
    t = np.repeat(np.arange(frames) / 60, 2)
    seen = rng.random(len(t)) < 0.9
    seen[0] = True
    unknown = np.full(seen.sum(), np.nan)
    tracks = Tracks(
        t[seen], np.tile([0, 3], frames)[seen], rng.normal(0, 1e-5, (seen.sum(), 2)),
        unknown, unknown,
    )
    angle = rng.uniform(-3, 3, 10)
    field = 2e-3 * np.column_stack([np.cos(angle), np.sin(angle)])
    frequency = rng.uniform(1, 20, 10) if rolling else None
    conditions = Conditions('rolling' if rolling else 'catalytic', radius=2.5e-6)
    return Session(tracks, Commands(np.arange(10) * 0.2, field, frequency), conditions)


def record(folder: Path, session: Session) -> Path:
    """The session as a recording."""
    with RecordingWriter(folder) as writer:
        writer.describe('session', {
            'propulsion': session.conditions.propulsion, 'radius_um': '2.5'})
        for message in SessionMessages(session).messages():
            writer.write(*message)
    return folder


def header(t_ns: int) -> object:
    """A std_msgs/Header with this stamp."""
    types = typestore().types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(t_ns, 1_000_000_000))
    return types['std_msgs/msg/Header'](stamp, 'workspace')


def encode(msgtype: str, *fields: object) -> bytes:
    """A message of this type with these fields as CDR bytes."""
    content = typestore().types[msgtype](*fields)
    return bytes(typestore().serialize_cdr(content, msgtype))


def image(t_ns: int, size: int = 64) -> bytes:
    """A square mono8 frame of noise."""
    pixels = np.random.default_rng(t_ns % 2**32).integers(0, 256, size * size, np.uint8)
    return encode(IMAGE, header(t_ns), size, size, 'mono8', 0, size, pixels)


def vector(t_ns: int, x: float, y: float) -> bytes:
    """A Vector3Stamped."""
    make = typestore().types['geometry_msgs/msg/Vector3']
    return encode(VECTOR, header(t_ns), make(x, y, 0.0))
