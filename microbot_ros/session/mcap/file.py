"""One MCAP file for reading, finished or cut off."""

from __future__ import annotations

import fcntl
from bisect import bisect_left
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, ChunkIndex, Metadata
from mcap.records import Message as McapMessage
from mcap.summary import Summary

from microbot_ros.common.errors import InputError, clipped
from microbot_ros.session.mcap.records import chunk_data, chunk_messages, file_records, stream_at
from microbot_ros.session.mcap.recovery import BROKEN, complete_index, recover_summary
from microbot_ros.session.mcap.writer import MAGIC, closing_bytes

_FOOTER_BYTES = 9 + 20 + len(MAGIC)  # MCAP specification: opcode, length, content and magic


class Message(NamedTuple):
    """Recorded message: its `topic` and `type`, time of receipt `t_ns` [ns], CDR `data`."""

    topic: str
    type: str
    t_ns: int
    data: bytes


class McapFile:
    """MCAP file at `path` that needs no index: one is made if a crash left none.

    `complete` tells whether it had a valid one. An unfinished record and all after it are ignored.
    `summary` holds schemas, channels, chunks and counts.

    Parameters
    ----------
    path : Path
        File or folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = path.open('rb')
        except OSError as error:
            problem = f'expected a readable recording ({error.strerror})'
            raise InputError(path, problem) from None
        try:
            head = self._file.read(len(MAGIC))
            if head != MAGIC or self._file.read(1) not in (b'', bytes([Opcode.HEADER])):
                found = 'something else' if head else 'an empty file'
                raise InputError(path, f'expected an MCAP recording, found {found}')
            self.complete = _has_footer(self._file)
            self.summary, self._end = self._find_summary()
        except BaseException:
            self.close()
            raise

    def messages(
        self, topics: Collection[str] | None, start_ns: int, end_ns: int,
    ) -> Iterator[Message]:
        """Yield messages of `topics` (None: all), `start_ns` <= t_ns < `end_ns`, as received.

        Only chunks that hold such messages are read, each when needed. Raises InputError for a
        damaged one.

        Parameters
        ----------
        topics : collection of str or None
            Names of topics; None for all.
        start_ns : int
            Beginning [ns].
        end_ns : int
            End [ns], excluded.

        Yields
        ------
        Message
            The message.
        """
        wanted = {
            id_: (channel.topic, self.summary.schemas[channel.schema_id].name)
            for id_, channel in self.summary.channels.items()
            if topics is None or channel.topic in topics
        }
        if not self.summary.chunk_indexes:
            yield from self._bare_messages(wanted, start_ns, end_ns)
            return
        chunks = sorted(
            (chunk for chunk in self.summary.chunk_indexes
             if chunk.message_end_time >= start_ns and chunk.message_start_time < end_ns
             and (not chunk.message_index_offsets or chunk.message_index_offsets.keys() & wanted)),
            key=attrgetter('message_start_time'))
        # Chunks overlap in time: messages wait while the next chunk may hold earlier ones.
        waiting: list[Message] = []
        limits = [*(chunk.message_start_time for chunk in chunks[1:]), end_ns]
        for chunk, limit in zip(chunks, limits, strict=False):
            waiting += self._inside(chunk, wanted, start_ns, end_ns)
            waiting.sort(key=attrgetter('t_ns'))
            ready = bisect_left(waiting, limit, key=attrgetter('t_ns'))
            yield from waiting[:ready]
            del waiting[:ready]

    def times(self, topic: str) -> np.ndarray:
        """Return times of receipt (n,) [ns] of a `topic`, ascending, from the message indexes.

        Parameters
        ----------
        topic : str
            Name of the topic.

        Returns
        -------
        ndarray, shape (n,)
            Times [ns].
        """
        ids = {id_ for id_, channel in self.summary.channels.items() if channel.topic == topic}
        chunks = self.summary.chunk_indexes
        if not chunks or not all(chunk.message_index_offsets for chunk in chunks):
            everything = self.messages([topic], 0, 2**63)
            return np.array([message.t_ns for message in everything], np.int64)
        found = [np.empty(0, np.int64)]
        for chunk in chunks:
            offsets = chunk.message_index_offsets
            found += [self._indexed_times(offsets[id_]) for id_ in ids & offsets.keys()]
        return np.sort(np.concatenate(found))

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attached files.

        Yields
        ------
        Attachment
            The file.
        """
        with self._sound():
            for index in self.summary.attachment_indexes:
                yield Attachment.read(stream_at(self._file, index.offset))

    def metadata(self) -> Iterator[Metadata]:
        """Yield the named sets of keys and values.

        Yields
        ------
        Metadata
            The set.
        """
        with self._sound():
            for index in self.summary.metadata_indexes:
                yield Metadata.read(stream_at(self._file, index.offset))

    def repair(self) -> None:
        """Replace an unfinished last record by the missing index.

        Raises InputError if the recorder is still writing.
        """
        if self.complete:
            return
        with self.path.open('r+b') as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                problem = 'expected a recording that no program is writing'
                raise InputError(self.path, problem) from None
            file.truncate(self._end)
            if self.summary.chunk_indexes:
                self._end += complete_index(file, self.summary.chunk_indexes[-1], self._end)
            file.seek(self._end)
            file.write(closing_bytes(self.summary, self._end))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _find_summary(self) -> tuple[Summary, int]:
        if self.complete:
            self._file.seek(0)
            try:
                summary = make_reader(self._file).get_summary()
            except BROKEN:
                summary = None
            if summary is not None and summary.statistics is not None and summary.channels:
                return summary, 0
            self.complete = summary is not None
        with self._sound():
            recovered, end = recover_summary(self._file)
        return recovered, end

    @contextmanager
    def _sound(self) -> Iterator[None]:
        """Convert errors of damaged bytes to InputError."""
        try:
            yield
        except InputError:
            raise
        except BROKEN as error:
            raise InputError(self.path, 'expected a sound recording, found damaged data '
                                        f'({clipped(str(error) or type(error).__name__)})'
                             ) from None

    def _inside(
        self, index: ChunkIndex, wanted: dict[int, tuple[str, str]], start_ns: int, end_ns: int,
    ) -> list[Message]:
        with self._sound():
            data = chunk_data(self._file, index)
            return [
                Message(*wanted[channel], t_ns, data[begin:end])
                for channel, t_ns, _, begin, end in chunk_messages(data)
                if channel in wanted and start_ns <= t_ns < end_ns
            ]

    def _bare_messages(
        self, wanted: dict[int, tuple[str, str]], start_ns: int, end_ns: int,
    ) -> Iterator[Message]:
        """Yield the messages of a file without chunks, in the order of the file."""
        with self._sound():
            for place in file_records(self._file):
                if place.opcode == Opcode.MESSAGE:
                    length = place.end - place.content
                    record = McapMessage.read(stream_at(self._file, place.start), length)
                    if record.channel_id in wanted and start_ns <= record.log_time < end_ns:
                        yield Message(*wanted[record.channel_id], record.log_time, record.data)

    def _indexed_times(self, offset: int) -> np.ndarray:
        with self._sound():
            content = stream_at(self._file, offset)
            content.read2()
            return np.frombuffer(content.read(content.read4()), '<i8')[::2]


def _has_footer(file: BinaryIO) -> bool:
    size = file.seek(0, 2)
    if size < _FOOTER_BYTES + len(MAGIC):
        return False
    file.seek(-_FOOTER_BYTES, 2)
    tail = file.read()
    return tail[0] == Opcode.FOOTER and tail.endswith(MAGIC)
