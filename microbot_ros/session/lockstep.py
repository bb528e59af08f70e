"""Playing in lock-step: the next frame goes out when everybody has answered the last."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator

from microbot_ros.common.errors import InputError
from microbot_ros.session.playback import Playback
from microbot_ros.session.recording import Message, is_topic

FRAMES = ('camera/image_raw', 'particles', 'model/state', 'field/command')
"""What sets the nodes going; each answers the one before."""


def frame_topic(topics: Collection[str], answers: Collection[str] = ()) -> str:
    """The one of these topics that sets the nodes going; '' where none does.

    The first in the order of the graph, but for what the first of the nodes that give `answers`
    only takes beside its frame: a controller is set going by `model/state`, not by `particles`.
    """
    places = [place for place, name in enumerate(FRAMES[1:]) for answer in answers
              if is_topic(answer, name)]
    names = [*FRAMES[min(places, default=0):], *FRAMES]
    return next((topic for name in names for topic in topics if is_topic(topic, name)), '')


class LockStep:
    """Holds a playback back while the last frame is still being worked on.

    A frame is answered by a message with its stamp on every topic of `answers`, in the order of
    the nodes that give them. Without answers this is the playback, and nothing is held back.
    """

    def __init__(self, playback: Playback, frame: str, answers: Collection[str] = ()) -> None:
        self._playback = playback
        self._answers = tuple(answers)
        self._frame = frame
        self._missing: dict[str, int] = {}

    @property
    def missing(self) -> dict[str, int]:
        """Answers that are still to come, by topic: the stamp [ns] they must have."""
        return self._missing

    @property
    def finished(self) -> bool:
        """Whether everything has been sent and answered."""
        return self._playback.finished and not self._missing

    def take(self, now: float) -> Iterator[Message]:
        """What is due at `now` [s], up to the next frame that must be answered."""
        while not self._missing and (message := self._playback.take(now)) is not None:
            yield self._sent(message)

    def step(self, now: float) -> Iterator[Message]:
        """Pause, and hand out the next message, unless an answer is still to come.

        `now` [s] is from any steady clock.
        """
        if not self._missing:
            yield from map(self._sent, self._playback.step(now))

    def expect(self, topic: str, stamp_ns: int) -> None:
        """Wait also for an answer on `topic` of stamp `stamp_ns` [ns]."""
        self._missing[topic] = stamp_ns

    def answer(self, topic: str, stamp_ns: int) -> None:
        """An answer on `topic` of stamp `stamp_ns` [ns] has come; another than is missing is
        nothing.
        """
        if self._missing.get(topic) == stamp_ns:
            del self._missing[topic]

    def _sent(self, message: Message) -> Message:
        if message.topic == self._frame:
            stamp = header_stamp_ns(message.data)
            for topic in self._answers:
                self.expect(topic, stamp)
        return message


def header_stamp_ns(data: bytes) -> int:
    """The stamp [ns] in serialised `data` of a message that begins with a std_msgs/Header.

    OMG CDR: an encapsulation of four bytes whose second is odd for little-endian, then `int32 sec,
    uint32 nanosec`. InputError for what is too short to hold one.
    """
    if len(data) < 12:
        raise InputError('lock-step', f'expected a message with a header, found {len(data)} bytes')
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] & 1 else '>iI', data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
