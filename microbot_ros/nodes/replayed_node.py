"""One of today's nodes, with what it took when it was recorded and what it says to that today."""

from __future__ import annotations

import contextlib
import queue
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from rclpy.serialization import serialize_message

from microbot_ros.nodes.offline import Offline
from microbot_ros.nodes.topics import CHANGES, type_name
from microbot_ros.session.accounts import (
    CHANGE,
    FRAME,
    Doubt,
    Taken,
    Turn,
    kept_turns,
    lasting,
    likely_turns,
)
from microbot_ros.session.bag import whole
from microbot_ros.session.inputs import Inputs, OfNode
from microbot_ros.session.lockstep import header_stamp_ns
from microbot_ros.session.playback import Source
from microbot_ros.session.recorder import RecordingWriter
from microbot_ros.session.recording import is_topic

_ANSWER_SECONDS = 1.0
"""How long a node that answers from a thread of its own may take."""
_REMEMBERED = 5000
"""Answers of a node that are kept for those who take them."""


@dataclass(frozen=True)
class Stage:
    """What a node takes, the topic on which it answers each frame, what it `also` says then."""

    node: str
    takes: tuple[str, ...]
    answer: str
    also: tuple[str, ...] = ()


class SilentError(Exception):
    """A node that must answer does not."""


class ReplayedNode:
    """A node in play at a `stage`: its turns up to `end_ns`, and what it has said in this replay.

    Turns come from `source`, what it says goes to `writer`; `names` are the namespace and the
    topic that sets all nodes going.
    """

    def __init__(self, node: Offline, stage: Stage, source: Source, names: tuple[str, str],
                 writer: RecordingWriter, end_ns: int) -> None:
        namespace, first = names
        self.answer = f'{namespace}/{stage.answer}'
        self.played: set[int] = set()
        """The stamps [ns] of the frames that it took."""
        self.doubts: list[Doubt] = []
        self._said: dict[tuple[str, int], bytes] = {}
        self._node, self._stage, self._namespace, self._writer = node, stage, namespace, writer
        self._frame = stage.takes[0]
        topics = {name: topic for name in stage.takes if name in node.inlets
                  for topic in source.topics if is_topic(topic, name)}
        topics |= {CHANGE: CHANGES} if CHANGES in source.topics else {}
        own = OfNode(source, f'{namespace}/{stage.node}')
        self._inputs = Inputs(own, topics)
        account = f'{namespace}/{stage.node}/account'
        asides = {topic: name for name, topic in topics.items() if name != self._frame}
        self._turns = (
            kept_turns(own, account, stage.node, self._frame) if account in own.topics else
            likely_turns(own, topics.get(self._frame, first), self.answer, asides))
        if stage.node == 'coil_driver':
            self._turns = self._answered(own)
        self._end_ns, self._reached = end_ns, 0
        self._next: Turn | None = None
        self._go_on()

    def _answered(self, source: Source) -> Iterator[Turn]:
        """The commands that a coil driver took; it refuses what is late, and forgets all else."""
        answers = ({header_stamp_ns(m.data) for m in source.messages([self.answer])}
                   if self.answer in source.topics else set())
        turns = self._turns
        return (Turn((Taken(FRAME, turn.stamp_ns, turn.stamp_ns),)) for turn in turns
                if turn.stamp_ns in answers or not answers)

    @property
    def over(self) -> bool:
        """Whether it has taken all."""
        return self._next is None

    @property
    def now_ns(self) -> int:
        """When it took the frame that is next [ns]."""
        return self._next.taken[-1].at_ns if self._next else self._end_ns

    def gives(self, name: str) -> bool:
        """Whether it publishes on a topic, `name` without namespace."""
        return name in (self._stage.answer, *self._stage.also)

    def ready(self, parts: Sequence[ReplayedNode]) -> bool:
        """Whether all that it took for its next frame has been said by `parts`, or never will be.
        """
        assert self._next is not None
        return all(
            part.over or part._reached >= taken.stamp_ns for taken in self._next.taken
            for part in parts if part is not self and part.gives(taken.name or self._frame))

    def step(self, parts: Sequence[ReplayedNode]) -> None:
        """Take what it took up to and with its next frame, of what `parts` have said where they
        did.
        """
        turn = self._next
        assert turn is not None
        stamp = turn.stamp_ns
        self.doubts += turn.doubts
        for taken in turn.taken:
            took = self._take(taken, stamp, parts)
            self._listen(taken.at_ns)
        if took and self._stage.node == 'coil_driver':
            self._wait(stamp)
        for reason in (self._node.unrepeatable, self._node.withheld):
            if reason not in ('', *(doubt.reason for doubt in self.doubts)):
                self.doubts.append(lasting(stamp, reason))
        self.played.add(stamp)
        self._reached = stamp
        self._go_on()

    def _go_on(self) -> None:
        self._next = next(self._turns, None)
        if self._next is not None and self.now_ns > self._end_ns:
            self._next = None

    def _take(self, taken: Taken, frame_ns: int, parts: Sequence[ReplayedNode]) -> bool:
        """Whether there was such a thing to take."""
        name = taken.name or self._frame
        if name in self._node.alarms:
            self._node.act(name, taken.at_ns, taken.verdicts)
            return True
        if name != CHANGE and name not in self._node.inlets:
            return False
        data = self._data(name, taken, frame_ns, parts)
        if data is None:
            return False
        self._node.be_told(name, data, taken.at_ns, taken.verdicts)
        return True

    def _data(self, name: str, taken: Taken, frame_ns: int, parts: Sequence[ReplayedNode],
              ) -> bytes | None:
        """What it took: as said today by who is in play, else as recorded."""
        for part in parts:
            if part.gives(name):
                said = part._said.get((name, taken.stamp_ns))
                if said is not None or taken.stamp_ns in part.played:
                    return said
        found = self._inputs.find(name, taken.stamp_ns, taken.at_ns)
        if found is None:
            self.doubts.append(lasting(
                frame_ns, f'what the {self._stage.node} took from {name} was not recorded'))
        return found

    def _wait(self, stamp_ns: int) -> None:
        """Wait for an answer that comes from a thread of the node's own."""
        deadline = time.monotonic() + _ANSWER_SECONDS
        while (self._stage.answer, stamp_ns) not in self._said:
            if time.monotonic() > deadline:
                raise SilentError(f'the {self._stage.node} did not answer a command within '
                                  f'{_ANSWER_SECONDS:g} s')
            self._listen(stamp_ns, 0.1)

    def _listen(self, at_ns: int, seconds: float = 0.0) -> None:
        """Keep and write what it has said, at the time [ns] of what it was said to."""
        with contextlib.suppress(queue.Empty):
            while True:
                name, message = self._node.said.get(seconds > 0, seconds or None)
                seconds = 0.0
                if self.gives(name):
                    data = whole(serialize_message(message), type_name(type(message)))
                    self._said[name, header_stamp_ns(data)] = data
                    self._writer.write(
                        f'{self._namespace}/{name}', type_name(type(message)), at_ns, data)
        for forgotten in [*islice(self._said, max(0, len(self._said) - _REMEMBERED))]:
            del self._said[forgotten]
