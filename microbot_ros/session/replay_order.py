"""What came in while a frame was worked on, in the order in which it was taken."""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Collection, Iterator
from operator import attrgetter

from microbot_ros.session.lockstep import header_stamp_ns
from microbot_ros.session.playback import Source
from microbot_ros.session.recording import Message, is_topic

CHANGES = 'parameter_events'
GOALS = ('goals', 'particle_goals', 'goal_pose', 'path', 'field/plan', 'joy')
"""What people tell the controller, at any time."""
_HEARD = 'model/state'
"""What sets the controller going: a goal that comes later waits until it is done."""


class ReplayOrder:
    """A source in which goals and changes stand before the frame that first felt them.

    The recorder heard the frame when it was exposed, a goal some milliseconds later, and after
    that what the controller answered, in the light of the goal. In lock-step a frame is answered
    before the next message is sent, so the goal has to be sent before the frame. A goal was felt
    if it came before the controller was set going; a change, which the node itself reports, if it
    came before the answer.
    """

    def __init__(self, source: Source, frame: str, answer: str) -> None:
        self.topics, self.start_ns, self.end_ns = source.topics, source.start_ns, source.end_ns
        self._source = source
        self._asides = {topic for topic in source.topics
                        if any(is_topic(topic, name) for name in (CHANGES, *GOALS))}
        self._answered: list[tuple[int, int]] = []
        self._heard: list[tuple[int, int]] = []
        if self._asides:
            sent = {header_stamp_ns(m.data): m.t_ns for m in source.messages([frame])}
            heard = next((topic for topic in source.topics if is_topic(topic, _HEARD)), answer)
            self._answered, self._heard = self._turns(answer, sent), self._turns(heard, sent)

    def _turns(self, topic: str, sent: dict[int, int]) -> list[tuple[int, int]]:
        """When a message on a topic came, and when the frame of its stamp had been sent."""
        if topic not in self.topics:
            return []
        return sorted((m.t_ns, sent[stamp]) for m in self._source.messages([topic])
                      if (stamp := header_stamp_ns(m.data)) in sent)

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """As of the source, but for the moments of goals and changes: of `topics` (None: all) from
        `start_ns` up to `end_ns` [ns].
        """
        chosen = set(self.topics if topics is None else topics)
        asides = sorted((message._replace(t_ns=self._moved(message))
                         for message in self._source.messages(chosen & self._asides)),
                        key=attrgetter('t_ns'))
        low = self.start_ns if start_ns is None else start_ns
        high = self.end_ns + 1 if end_ns is None else end_ns
        return heapq.merge(
            (message for message in asides if low <= message.t_ns < high),
            self._source.messages(chosen - self._asides, low, high), key=attrgetter('t_ns'))

    def _moved(self, message: Message) -> int:
        """The moment of the first frame that felt the message, if that is earlier."""
        turns = self._answered if is_topic(message.topic, CHANGES) else self._heard
        following = bisect_right(turns, (message.t_ns, 0))
        return min([message.t_ns, *(sent for _, sent in turns[following:following + 1])])
