"""Schedule of the messages of a session: rate, limits, loop, pause, step and seek."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from microbot_ros.common.errors import InputError
from microbot_ros.session.mcap.recording import (
    Message,
    Recording,
    is_recording,
    is_topic,
)
from microbot_ros.session.replay.as_messages import SessionMessages
from microbot_ros.session.tables.folder import read_folder

SLOWEST, FASTEST = 0.1, 100.0  # choices: limits of the rate, times real time

Source = Recording | SessionMessages
"""What can be played."""


@contextmanager
def open_source(path: str | Path) -> Iterator[Source]:
    """Open the session at `path`, a folder or a recording, for playing.

    Parameters
    ----------
    path : str or Path
        File or folder.

    Yields
    ------
    Source
        The session or recording.
    """
    path = Path(path)
    if path.exists() and not is_recording(path):
        yield SessionMessages(read_folder(path))
    else:
        with Recording(path) as recording:
            if not recording.end_ns:
                raise InputError(path, 'expected messages, found no whole one')
            yield recording


class Playback:
    """Schedule of the messages of a source.

    It has no clock: the caller passes the time `now` [s] of any steady clock, sends the messages
    of `take` and publishes `clock_ns`.

    Parameters
    ----------
    source : Source
        Source of the messages.
    now : float [s]
        Present time.
    rate : float
        Times real time, 0.1 to 100, or infinite for as fast as possible.
    start, end : float [s]
        Since the beginning of the source.
    loop : bool
        Whether the start follows the end; the clock then jumps back.
    topics : collection of str, optional
        By name, with or without namespace.

    Raises
    ------
    InputError
        For a rate or limits out of range, and for missing topics.
    """

    _next: Message | None

    def __init__(
        self, source: Source, now: float, *, rate: float = 1.0, start: float = 0.0,
        end: float | None = None, loop: bool = False, topics: Collection[str] | None = None,
    ) -> None:
        self._source = source
        self._topics = None if topics is None else _chosen(source, topics)
        length = (source.end_ns - source.start_ns) / 1e9
        if not 0 <= start <= length:
            raise InputError('start', f'expected 0 to {length:g} s; received {start:g}')
        if end is not None and not start <= end < math.inf:
            raise InputError('end', f'expected {start:g} s or more; received {end:g}')
        self._first = source.start_ns + round(start * 1e9)
        self._last = source.end_ns if end is None else min(
            source.end_ns, source.start_ns + round(end * 1e9))
        self._loop = loop
        self._paused = False
        self._rate = _checked_rate(rate)
        self._go_to(self._first, now)

    @property
    def finished(self) -> bool:
        """Whether everything has been taken; never so in a loop that holds a message."""
        return self._next is None

    @property
    def paused(self) -> bool:
        """Whether only `step` advances."""
        return self._paused

    def take(self, now: float) -> Message | None:
        """Return the next message if it is due at `now` [s], else None.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        Message or None
            The message, or None.
        """
        if self._paused or self._next is None or self.wait(now) > 0:
            return None
        return self._advance(now)

    def wait(self, now: float) -> float:
        """Return seconds from `now` until the next message is due; infinity if none will be.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        float
            Time [s].
        """
        if self._paused or self._next is None:
            return math.inf
        if self._rate == math.inf:
            return 0.0
        due = self._since + (self._next.t_ns - self._at) / 1e9 / self._rate
        return max(0.0, due - now)

    def clock_ns(self, now: float) -> int:
        """Return the time for `/clock` at `now` [s]; it never passes a message not yet taken.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        int
            Time [ns].
        """
        limit = self._last if self._next is None else self._next.t_ns
        if self._paused or self._rate == math.inf:
            return min(self._at, limit)
        return min(self._at + round((now - self._since) * 1e9 * self._rate), limit)

    def pause(self, now: float) -> None:
        """Stop the clock at `now` [s].

        Parameters
        ----------
        now : float
            Present time [s].
        """
        self._at, self._paused = self.clock_ns(now), True

    def resume(self, now: float) -> None:
        """Let the clock continue at `now` [s].

        Parameters
        ----------
        now : float
            Present time [s].
        """
        self._since, self._paused = now, False

    def set_rate(self, rate: float, now: float) -> None:
        """Change the `rate` from `now` [s] on; InputError if out of range.

        Parameters
        ----------
        rate : float
            Speed relative to real time.
        now : float
            Present time [s].
        """
        rate = _checked_rate(rate)
        self._at, self._since, self._rate = self.clock_ns(now), now, rate

    def seek(self, seconds: float, now: float) -> None:
        """Go to `seconds` since the start of the source, within the limits, at `now` [s].

        Parameters
        ----------
        seconds : float
            Time since the start of the source [s].
        now : float
            Present time [s].
        """
        position = seconds * 1e9 + self._source.start_ns
        if not self._first <= position <= self._last:
            low, high = (
                (limit - self._source.start_ns) / 1e9 for limit in (self._first, self._last))
            raise InputError('seek', f'expected {low:g} to {high:g} s; received {seconds:g}')
        self._go_to(round(position), now)

    def step(self, now: float, topic: str | None = None) -> Iterator[Message]:
        """Pause at `now` [s] and yield the next message, or all up to the next of `topic`.

        Parameters
        ----------
        now : float
            Present time [s].
        topic : str or None
            Name of a topic; None for any.

        Yields
        ------
        Message
            The message.
        """
        self.pause(now)
        while self._next is not None:
            message = self._advance(now)
            yield message
            if topic is None or is_topic(message.topic, topic):
                return

    def _advance(self, now: float) -> Message:
        message = self._next
        assert message is not None
        if self._paused or self._rate == math.inf:
            self._at = message.t_ns
        self._next = next(self._stream, None)
        if self._next is None and self._loop:
            self._go_to(self._first, now)
        return message

    def _go_to(self, position: int, now: float) -> None:
        self._at, self._since = position, now
        self._stream = self._source.messages(self._topics, position, self._last + 1)
        self._next = next(self._stream, None)


def _checked_rate(rate: float) -> float:
    if not (SLOWEST <= rate <= FASTEST or rate == math.inf):
        raise InputError('rate', f'expected {SLOWEST:g} to {FASTEST:g}, or inf; received {rate:g}')
    return rate


def _chosen(source: Source, names: Collection[str]) -> list[str]:
    chosen = []
    for name in names:
        found = [topic for topic in source.topics if is_topic(topic, name.lstrip('/'))]
        if not found:
            there = ', '.join(sorted(source.topics)) or 'none'
            raise InputError('topics', f'expected some of {there}; received {name}')
        chosen += found
    return chosen
