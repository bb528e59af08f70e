"""What each answer was made from: as the node itself says, or as far as a recording shows it.

A node writes on `NODE/account`, after every frame that it took, a line of JSON:
`{"turn": 17, "taken": [["goals", stamp_ns, at_ns], ["model/state", stamp_ns, at_ns, "tl"]]}`.
`turn` counts its frames since it was configured, but is the same in a line that is written before
there is a frame; `taken` lists, in order, what it took since the
frame before, by topic, stamp and the node's time then. `parameters` stands for a change of its
parameters, `_watch` and the like for a timer that acted, `calls` for calls to a controller that
belong to nothing that is kept. A fourth entry, a letter per call, says that not all calls to a
controller came in time.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from microbot_ros.common.errors import InputError
from microbot_ros.session.lockstep import header_stamp_ns
from microbot_ros.session.playback import Source
from microbot_ros.session.recording import Message
from microbot_ros.session.replay_order import ReplayOrder

CHANGE, CALLS, FRAME = 'parameters', 'calls', ''
IN_TIME, LATE, BUSY, HUNG = 't', 'l', 'b', 'h'
"""How a call came out: in time; too late, its value unused; not begun, since the one before still
went on; not begun, and the one before left behind."""

UNKNOWN_ORDER_NS = 3_000_000
"""Of two messages that reach a recorder within this of each other, either may have reached another
node first."""

HEALED_NS = 1_000_000_000
"""Which of two messages was first is forgotten within this."""


class Taken(NamedTuple):
    """One thing that a node took: topic (without namespace) or another name, the stamp of the
    message, `stamp_ns` [ns], the node's time, `at_ns` [ns], and in `verdicts` how calls to a
    controller came out ('': in time).
    """

    name: str
    stamp_ns: int
    at_ns: int
    verdicts: str = ''


@dataclass(frozen=True)
class Turn:
    """What a node took up to and with one frame, the last entry; `doubts` say why that, or what
    the node knew before, is not certain."""

    taken: tuple[Taken, ...]
    doubts: tuple[Doubt, ...] = ()

    @property
    def stamp_ns(self) -> int:
        """The stamp of the frame."""
        return self.taken[-1].stamp_ns


@dataclass(frozen=True)
class Doubt:
    """Frames with stamps from `first_ns` to `last_ns` [ns] that can't be judged, and the `reason`.
    """

    first_ns: int
    last_ns: float
    reason: str


def lasting(first_ns: int, reason: str) -> Doubt:
    """A doubt from `first_ns` [ns] on, about what a node remembers: nothing takes it away again.

    `reason` says why, for people.
    """
    return Doubt(first_ns, math.inf, reason)


def unjudgeable(same: Mapping[int, bool], doubts: Iterable[Doubt]) -> dict[int, str]:
    """Of frames (stamp [ns] → whether the answer is the same) those that differ for all we know
    because of a doubt, and why.

    A doubt about one frame explains that it differs, and the frames after it until one is the
    same again, if that takes no longer than `HEALED_NS`: an answer to another input.
    """
    doubts = sorted(doubts, key=lambda doubt: doubt.first_ns)
    ever = next((doubt for doubt in doubts if doubt.last_ns == math.inf), None)
    once = {doubt.first_ns: doubt.reason for doubt in reversed(doubts)}
    found: dict[int, str] = {}
    for differ, run in groupby(sorted(same), key=lambda stamp: not same[stamp]):
        stamps = [*run]
        if differ and ever is not None and ever.first_ns <= stamps[0]:
            found |= dict.fromkeys(stamps, ever.reason)
        elif differ and stamps[0] in once and stamps[-1] - stamps[0] <= HEALED_NS:
            found |= dict.fromkeys(stamps, once[stamps[0]])
    return found


def kept_turns(source: Source, topic: str, node: str, frame: str) -> Iterator[Turn]:
    """What a node says in its recorded account; `frame` (without namespace) sets it going.

    InputError where the topic holds no accounts.
    """
    turn, taken, doubts = 0, tuple[Taken, ...](), list[Doubt]()
    for message in source.messages([topic]):
        number, more = _read(message)
        taken += more
        whole = taken[-1].name == frame
        stamp = taken[-1].stamp_ns if whole else taken[-1].at_ns
        if number < turn + whole:
            doubts.append(lasting(stamp, f'the {node} was started again'))
        elif number > turn + whole:
            what = 'of which no account was kept' if turn else 'before the recording began'
            doubts.append(lasting(stamp, f'the {node} had taken frames {what}'))
        if any(one.name == CALLS for one in more):
            doubts.append(lasting(stamp, f'the {node} refused what it was asked for'))
        turn = number
        if whole:
            yield Turn(taken, tuple(doubts))
            taken, doubts = (), []


def _read(message: Message) -> tuple[int, tuple[Taken, ...]]:
    """The number of the turn, and what was taken."""
    try:
        entry = json.loads(_text(message.data))
        taken = tuple(Taken(str(one[0]), int(one[1]), int(one[2]), *map(str, one[3:4]))
                      for one in entry['taken'])
        return int(entry['turn']), (taken[0], *taken[1:])
    except (ValueError, KeyError, TypeError, IndexError):
        raise InputError(message.topic, 'expected the account of a node, found something '
                                        'else') from None


def likely_turns(source: Source, frame: str, answer: str, others: dict[str, str],
                 ) -> Iterator[Turn]:
    """What a node most likely took for each frame of a recording without accounts.

    `frame`, `answer` and `others` (what else it takes, with their names) are topics of the
    recording. Doubtful are frames with which something else came so closely, or while they were
    worked on, that their order can't be known, and all after one without an answer.
    """
    answered = ({header_stamp_ns(m.data): m.t_ns for m in source.messages([answer])}
                if answer in source.topics else {})
    arrivals = {others[topic]: [m.t_ns for m in source.messages([topic])] for topic in others}
    taken: list[Taken] = []
    for message in ReplayOrder(source, frame, answer).messages([frame, *others]):
        if message.topic != frame:
            name = others[message.topic]
            taken.append(Taken(name, header_stamp_ns(message.data), message.t_ns))
            continue
        stamp, t = header_stamp_ns(message.data), message.t_ns
        end = max(answered.get(stamp, t), t + UNKNOWN_ORDER_NS)
        doubts = [Doubt(stamp, stamp, f'the order of {name} and the frame is not known')
                  for name, times in arrivals.items()
                  if bisect_left(times, t - UNKNOWN_ORDER_NS) < bisect_right(times, end)]
        if answered and stamp not in answered:
            doubts.append(lasting(stamp, 'why a frame was not answered is not known'))
        yield Turn((*taken, Taken(FRAME, stamp, t)), tuple(doubts))
        taken = []


def _text(data: bytes) -> str:
    """The content of a serialised std_msgs/String, little-endian: its length with the closing
    zero, then the bytes."""
    return data[8:8 + int.from_bytes(data[4:8], 'little' if data[1] & 1 else 'big')
                - 1].decode()
