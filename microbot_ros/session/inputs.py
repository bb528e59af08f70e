"""Recorded messages by what a node says of them: topic, stamp and about when."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator

from microbot_ros.session.accounts import CHANGE
from microbot_ros.session.lockstep import header_stamp_ns
from microbot_ros.session.playback import Source
from microbot_ros.session.recording import Message, is_topic
from microbot_ros.session.replay_order import CHANGES

APART_NS = 2_000_000_000
"""A recorder hears a message no further than this from when another node takes it."""


class OfNode:
    """A source without the changes of parameters that other nodes report."""

    def __init__(self, source: Source, node: str) -> None:
        self.topics, self.start_ns, self.end_ns = source.topics, source.start_ns, source.end_ns
        self._source = source
        self._node = node.encode() + b'\0'

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """As of the source: of `topics` (None: all) from `start_ns` up to `end_ns` [ns]."""
        return (message for message in self._source.messages(topics, start_ns, end_ns)
                if not is_topic(message.topic, CHANGES) or self._is_own(message.data))

    def _is_own(self, data: bytes) -> bool:
        """Of a rcl_interfaces/ParameterEvent: an encapsulation of 4 bytes, a stamp of 8, the
        length of the node's name, the name."""
        return data[16:16 + len(self._node)] == self._node


class Inputs:
    """The recorded messages of some topics, each handed out once. `topics`: name → topic."""

    def __init__(self, source: Source, topics: dict[str, str]) -> None:
        self._names = {topic: name for name, topic in topics.items()}
        self._stream = source.messages([*self._names]) if topics else iter(())
        self._waiting: dict[str, deque[Message]] = {name: deque() for name in topics}
        self._read_ns = 0

    def find(self, name: str, stamp_ns: int, at_ns: int) -> bytes | None:
        """The message of stamp `stamp_ns` that came closest to the moment `at_ns` [ns]; None if
        none did.

        A change of parameters without a stamp is the last that was reported before the moment.
        """
        if name not in self._waiting:
            return None
        # Where the stamp is not enough to know it by, all that may be it must be there.
        self._read(at_ns if stamp_ns else at_ns + APART_NS)
        waiting = self._waiting[name]
        while waiting and waiting[0].t_ns < at_ns - APART_NS:
            waiting.popleft()
        while (found := self._best(name, stamp_ns, at_ns)) is None and (
                self._read_ns < at_ns + APART_NS):
            if not self._read(self._read_ns + 1):
                return None
        if found is None:
            return None
        waiting.remove(found)
        return found.data

    def _best(self, name: str, stamp_ns: int, at_ns: int) -> Message | None:
        if name == CHANGE and not stamp_ns:
            return max((m for m in self._waiting[name] if header_stamp_ns(m.data) <= at_ns),
                       key=lambda m: header_stamp_ns(m.data), default=None)
        same = [m for m in self._waiting[name] if header_stamp_ns(m.data) == stamp_ns]
        return min(same, key=lambda m: abs(m.t_ns - at_ns), default=None)

    def _read(self, until_ns: int) -> bool:
        """Read on up to a moment [ns]; whether there was anything more."""
        while self._read_ns < until_ns:
            message = next(self._stream, None)
            if message is None:
                return False
            self._read_ns = message.t_ns
            self._waiting[self._names[message.topic]].append(message)
        return True
