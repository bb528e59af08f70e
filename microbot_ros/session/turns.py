"""What came in while a frame was worked on, in the order in which it was taken."""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Collection, Iterator
from operator import attrgetter

from microbot_ros.session.lockstep import header_stamp_ns
from microbot_ros.session.playback import Source
from microbot_ros.session.recording import Message
from microbot_ros.session.topics import is_topic

ASIDES = ('parameter_events', 'goals', 'goal_pose', 'path', 'joy')
"""What people tell the controller, at any time."""


class InTurn:
    """A source in which goals and changes stand before the frame that first felt them.

    The recorder heard the frame when it was exposed, a goal some milliseconds later, and after
    that the answer, given in the light of the goal. In lock-step a frame is answered before the
    next message is sent, so the goal has to be sent before the frame.
    """

    def __init__(self, source: Source, frame: str, answer: str) -> None:
        self.topics, self.start_ns, self.end_ns = source.topics, source.start_ns, source.end_ns
        self._source = source
        self._asides = {topic for topic in source.topics
                        if any(is_topic(topic, name) for name in ASIDES)}
        self._answers: list[tuple[int, int]] = []
        if self._asides and answer in source.topics:
            sent = {header_stamp_ns(m.data): m.t_ns for m in source.messages([frame])}
            self._answers = sorted(
                (m.t_ns, sent[stamp]) for m in source.messages([answer])
                if (stamp := header_stamp_ns(m.data)) in sent)

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """As of the source, but for the moments of goals and changes."""
        chosen = set(self.topics if topics is None else topics)
        asides = [message._replace(t_ns=self._moved(message.t_ns))
                  for message in self._source.messages(chosen & self._asides)]
        low = self.start_ns if start_ns is None else start_ns
        high = self.end_ns + 1 if end_ns is None else end_ns
        return heapq.merge(
            (message for message in asides if low <= message.t_ns < high),
            self._source.messages(chosen - self._asides, low, high), key=attrgetter('t_ns'))

    def _moved(self, t_ns: int) -> int:
        """The moment of the frame whose answer was the first after `t_ns`, if that is earlier."""
        following = bisect_right(self._answers, (t_ns, 0))
        return min([t_ns, *(sent for _, sent in self._answers[following:following + 1])])
