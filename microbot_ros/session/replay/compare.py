"""Comparison of two recordings: topics that differ, and their first difference."""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from microbot_ros.session.mcap.cloud import cloud_table, is_cloud
from microbot_ros.session.mcap.from_recording import stamp_ns
from microbot_ros.session.mcap.recording import Recording

_Key = tuple[int, int]
"""Key that pairs two messages: their stamp [ns], and their number among those with that stamp."""


@dataclass(frozen=True)
class Doubt:
    """Differences from the stamp `first_ns` [ns] on cannot be judged, for a `reason` in words.

    They count nevertheless if more than `share` of all messages differ.
    """

    first_ns: int
    reason: str
    share: float = 1.0


@dataclass(frozen=True)
class FirstDifference:
    """First field of the first pair of messages that differ, `t_s` since the start of `a`.

    `field` is its path, `a` and `b` are its values.
    """

    t_s: float
    field: str
    a: str
    b: str


@dataclass(frozen=True)
class TopicDifference:
    """Differences of one `topic` between recordings a and b.

    `pairs` messages have a partner, `unequal` of them differ in some field; `only_a` and `only_b`
    have none. `first` is the first difference, `largest` the largest between numbers, by field.
    Messages whose difference cannot be judged count only in `unjudged`.
    """

    topic: str
    pairs: int
    unequal: int
    only_a: int
    only_b: int
    first: FirstDifference | None
    largest: dict[str, float]
    unjudged: int = 0

    @property
    def same(self) -> bool:
        """Whether the topic is equal in both."""
        return not (self.unequal or self.only_a or self.only_b)


def compare(
    a: Recording, b: Recording, topics: Collection[str] | None = None,
    stamps: Collection[int] | None = None, tolerance: float = 0.0,
    doubt: Doubt | None = None,
) -> list[TopicDifference]:
    """Compare the topics of two recordings field by field.

    Messages with a header are paired by its stamp, others by their order; times of receipt do not
    count. Serialised bytes are never compared, since their padding is arbitrary. NaN equals NaN.

    Parameters
    ----------
    a, b : Recording
        Recordings to compare.
    topics : collection of str, optional
        By default every topic of either recording.
    stamps : collection of int, optional [ns]
        Stamps of the messages that count.
    tolerance : float
        Relative to the largest number of a field.
    doubt : Doubt, optional
        Explains differences that are left unjudged.

    Returns
    -------
    list of TopicDifference
        Differences of each topic.
    """
    names = sorted({*a.topics, *b.topics} if topics is None else topics)
    return [_compare_topic(a, b, name, stamps, tolerance, doubt) for name in names]


@dataclass
class _Frame:
    """Comparison of all messages of a topic with one stamp."""

    pairs: int = 0
    unequal: int = 0
    only: list[int] = dataclasses.field(default_factory=lambda: [0, 0])
    first: FirstDifference | None = None
    largest: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def same(self) -> bool:
        return not (self.unequal or any(self.only))


def _compare_topic(
    a: Recording, b: Recording, topic: str, stamps: Collection[int] | None, tolerance: float,
    doubt: Doubt | None,
) -> TopicDifference:
    frames: defaultdict[int, _Frame] = defaultdict(_Frame)
    unpaired: list[dict[_Key, tuple[int, dict[str, Any]]]] = [{}, {}]
    for side, key, item in _keyed(a, b, topic):
        if stamps is not None and key[0] not in stamps:
            continue
        unpaired[side][key] = item
        if key not in unpaired[1 - side]:
            continue
        (t_ns, left), (_, right) = (entries.pop(key) for entries in unpaired)
        _pair(frames[key[0]], (t_ns - a.start_ns) / 1e9, left, right, tolerance)
    for side, entries in enumerate(unpaired):
        for stamp, _ in entries:
            frames[stamp].only[side] += 1
    unjudged = {stamp for stamp, frame in frames.items()
                if doubt is not None and not frame.same and stamp >= doubt.first_ns}
    if doubt is not None and len(unjudged) > doubt.share * len(frames):
        unjudged.clear()
    return _sum(topic, [frame for stamp, frame in frames.items() if stamp not in unjudged],
                len(unjudged))


def _pair(frame: _Frame, t_s: float, left: dict[str, Any], right: dict[str, Any],
          tolerance: float) -> None:
    partings = list(_partings(left, right, tolerance))
    frame.pairs += 1
    frame.unequal += bool(partings)
    for field, place, x, y, size in partings:
        frame.largest[field] = max(frame.largest.get(field, 0.0), size)
        frame.first = frame.first or FirstDifference(t_s, field + place, x, y)


def _sum(topic: str, frames: list[_Frame], unjudged: int) -> TopicDifference:
    largest: dict[str, float] = {}
    for frame in frames:
        for field, size in frame.largest.items():
            largest[field] = max(largest.get(field, 0.0), size)
    first = min((frame.first for frame in frames if frame.first), key=lambda one: one.t_s,
                default=None)
    return TopicDifference(
        topic, sum(frame.pairs for frame in frames), sum(frame.unequal for frame in frames),
        sum(frame.only[0] for frame in frames), sum(frame.only[1] for frame in frames), first,
        largest, unjudged)


def _keyed(
    a: Recording, b: Recording, topic: str,
) -> Iterator[tuple[int, _Key, tuple[int, dict[str, Any]]]]:
    """Yield messages of a topic of both in turn: (0 or 1, key to pair them, (time, fields))."""
    streams = {0: _entries(a, topic), 1: _entries(b, topic)}
    while streams:
        for side in list(streams):
            entry = next(streams[side], None)
            if entry is None:
                del streams[side]
            else:
                yield side, *entry


def _entries(
    recording: Recording, topic: str,
) -> Iterator[tuple[_Key, tuple[int, dict[str, Any]]]]:
    seen: Counter[int] = Counter()
    if topic not in recording.topics:
        return
    for message in recording.messages([topic]):
        content = recording.decode(message)
        stamp = stamp_ns(content) if hasattr(content, 'header') else 0
        seen[stamp] += 1
        yield (stamp, seen[stamp]), (message.t_ns, dict(_leaves(content, '')))


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield every leaf of a message by its path: 'header.stamp.sec', 'points.x', 'poses[3].x'."""
    names = _fields(value.__class__)
    if isinstance(value, list):
        for place, item in enumerate(value):
            yield from _leaves(item, f'{path[:-1]}[{place}].')
    elif not names:
        yield path[:-1], value
    elif is_cloud(value):
        points = cloud_table(value)
        for name in points.dtype.names or ():
            yield f'points.{name}', points[name]
        yield from _leaves(value.header, 'header.')
    else:
        for name in names:
            yield from _leaves(getattr(value, name), f'{path}{name}.')


@cache
def _fields(kind: type) -> tuple[str, ...]:
    """Return the names of a message's fields; none for other types."""
    if not dataclasses.is_dataclass(kind):
        return ()
    return tuple(field.name for field in dataclasses.fields(kind))


def _partings(
    left: dict[str, Any], right: dict[str, Any], tolerance: float,
) -> Iterator[tuple[str, str, str, str, float]]:
    """Yield (field, index, value in a, value in b, size) of every field that differs.

    The size is infinite if it is not a number.
    """
    for field in dict.fromkeys([*left, *right]):
        a, b = left.get(field), right.get(field)
        if _identical(a, b):
            continue
        x, y = np.asarray(a), np.asarray(b)
        if x.shape != y.shape or not {x.dtype.kind, y.dtype.kind} <= set('iuf'):
            if not np.array_equal(x, y):
                yield field, '', str(a), str(b), np.inf
            continue
        apart = np.abs(x.astype(float) - y.astype(float))
        allowed = tolerance * np.max(np.abs(x[np.isfinite(x)]), initial=0.0)
        unequal = ~((x == y) | (np.isnan(x) & np.isnan(y)) | (apart <= allowed))
        if unequal.any():
            place = np.unravel_index(np.argmax(unequal), x.shape)
            size = apart[unequal].max()
            where = f'[{", ".join(map(str, place))}]' if place else ''
            yield field, where, str(x[place]), str(y[place]), float(size)


def _identical(a: Any, b: Any) -> bool:
    """Return whether two fields are bytewise equal, which most are; a fast first test."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and isinstance(a, (int, float, str)) and bool(a == b)
