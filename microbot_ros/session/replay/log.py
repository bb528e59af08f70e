"""The ordered log of what the nodes of the loop took in: the topic `loop/log`.

A node writes a line of JSON after every frame that it took:
`{"node": "controller", "turn": 17, "taken": [["goals", 179531…606, 179531…456], …]}`.
`turn` counts its frames since it was configured. `taken` lists, in order, what it took since its
last line: a topic, the stamp of the message [ns] (or its content, where it has no header), and
the node's time [ns]. Three entries are no topics: `parameters` with the values that were set, null
where they were refused; `expire`, where poses stopped coming; `let_go`, where the node was
stopped. A fourth element has a letter for each call to a controller, where not all were in time.
"""

from __future__ import annotations

import json
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from microbot_ros.common.errors import InputError

if TYPE_CHECKING:
    from microbot_ros.session.mcap.recording import Message
    from microbot_ros.session.replay.playback import Source

LOG, PARAMETERS, EXPIRE, LET_GO = 'loop/log', 'parameters', 'expire', 'let_go'

_APART_NS = 2_000_000_000
"""Choice: longest time [ns] between the receipt of a message by a node and by the recorder, which
a machine that swaps delays by seconds. Twice that needs twice the memory; at half, such a
recording loses messages."""


class Entry(NamedTuple):
    """One thing that a node took in.

    `name` of a topic without its namespace, or as listed above; `what`: a stamp [ns] or a content;
    `at_ns`, the node's time; `calls`, how calls to a controller ended; `doubt`, why what the node
    knew before is not known, or ''.
    """

    name: str
    what: Any
    at_ns: int
    calls: str = ''
    doubt: str = ''


def read_log(source: Source, topic: str, node: str, frame: str) -> Iterator[Entry]:
    """Return what a `node`, which answers `frame`, took in, from the log on a recorded `topic`.

    Raises InputError for a line that is not of the log.

    Parameters
    ----------
    source : Source
        The recording or session.
    topic : str
        Topic of the log.
    node : str
        Name of the node.
    frame : str
        Topic that the node answers.

    Yields
    ------
    Entry
        The entry.
    """
    turn = 0
    for message in source.messages([topic]):
        name, number, entries = _line(message)
        if name != node:
            continue
        whole = entries[-1].name == frame
        doubt = ''
        if number < turn + whole:
            doubt = f'the {node} was started again'
        elif number > turn + whole:
            what = 'whose log was lost' if turn else 'before the recording began'
            doubt = f'the {node} had received frames {what}'
        turn = number
        yield entries[0]._replace(doubt=doubt)
        yield from entries[1:]


def order_of_receipt(source: Source, topics: Mapping[str, str]) -> Iterator[Entry]:
    """Return what a node may have taken in, in a recording without its log.

    `topics` of the recording → their names. The order is that of the recorder.

    Parameters
    ----------
    source : Source
        The recording or session.
    topics : mapping of str to str
        Name by recorded topic.

    Yields
    ------
    Entry
        The entry.
    """
    for message in source.messages([*topics]):
        yield Entry(topics[message.topic], header_stamp_ns(message.data), message.t_ns)


class Inputs:
    """Recorded messages of some topics, each returned once. `topics`: name → recorded topic.

    Parameters
    ----------
    source : Source
        The recording or session.
    topics : mapping of str to str
        Recorded topic by name.
    """

    def __init__(self, source: Source, topics: Mapping[str, str]) -> None:
        self._names = {topic: name for name, topic in topics.items()}
        self._stream = source.messages([*self._names]) if topics else iter(())
        self._waiting: dict[str, deque[Message]] = {name: deque() for name in topics}
        self._read_ns = 0

    def find(self, name: str, stamp_ns: int, at_ns: int) -> bytes | None:
        """Return the message `name` of `stamp_ns` received nearest to `at_ns` [ns], or None.

        Parameters
        ----------
        name : str
            Name of the topic.
        stamp_ns : int
            Stamp of the message [ns].
        at_ns : int
            Time of receipt [ns].

        Returns
        -------
        bytes or None
            The serialised message, or None.
        """
        waiting = self._waiting.get(name)
        if waiting is None:
            return None
        # A stamp of zero is that of every message of its topic: all candidates are read.
        self._read(at_ns if stamp_ns else at_ns + _APART_NS)
        while waiting and waiting[0].t_ns < at_ns - _APART_NS:
            waiting.popleft()
        while True:
            same = [m for m in waiting if header_stamp_ns(m.data) == stamp_ns]
            if same:
                found = min(same, key=lambda m: abs(m.t_ns - at_ns))
                waiting.remove(found)
                return found.data
            if self._read_ns >= at_ns + _APART_NS or not self._read(self._read_ns + 1):
                return None

    def _read(self, until_ns: int) -> bool:
        """Read on up to a time [ns] of receipt; return whether there was more to read."""
        while self._read_ns < until_ns:
            message = next(self._stream, None)
            if message is None:
                return False
            self._read_ns = message.t_ns
            self._waiting[self._names[message.topic]].append(message)
        return True


def _line(message: Message) -> tuple[str, int, list[Entry]]:
    """Return the node, the turn and the entries of a line of the log."""
    # A serialised std_msgs/String: encapsulation, length with the closing zero, the bytes.
    order = 'little' if message.data[1] & 1 else 'big'
    text = message.data[8:7 + int.from_bytes(message.data[4:8], order)]  # type: ignore[arg-type]
    try:
        line = json.loads(text.decode())
        entries = [Entry(str(one[0]), one[1], int(one[2]), *map(str, one[3:4]))
                   for one in line['taken']]
        return str(line['node']), int(line['turn']), [entries[0], *entries[1:]]
    except (ValueError, KeyError, TypeError, IndexError):
        raise InputError(message.topic, 'expected a line of the loop log') from None


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp [ns] in serialised `data` of a message that begins with a std_msgs/Header.

    OMG CDR: an encapsulation of four bytes whose second is odd for little-endian, then `int32 sec,
    uint32 nanosec`. Raises InputError if the data are too short.

    Parameters
    ----------
    data : bytes
        The serialised message.

    Returns
    -------
    int
        Stamp [ns].
    """
    if len(data) < 12:
        raise InputError('message', f'expected a message with a header, found {len(data)} bytes')
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] & 1 else '>iI', data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
