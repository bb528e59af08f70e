"""What is in an MCAP file: from its index, or, where a crash left none, from the data itself."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream
from mcap.summary import Summary

from microbot_ros.errors import InputError
from microbot_ros.session.segment import (
    MAGIC,
    attachment_index,
    bytes_of,
    closing_bytes,
    count_chunk,
    empty_summary,
)

_FOOTER_BYTES = 9 + 20 + len(MAGIC)
_CHUNK_HEAD = 8 + 8 + 8 + 4


class IndexedReader(SeekingReader):
    """A reader of MCAP files that needs no index in the file: it makes one where there is none.

    `complete` says whether the file had one. A record that a crash left unfinished, and what
    follows it, is not there for this reader.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._input = path.open('rb')
        except OSError as error:
            problem = f'expected a readable recording ({error.strerror})'
            raise InputError(path, problem) from None
        head = self._input.read(len(MAGIC))
        if head != MAGIC:
            self._input.close()
            found = 'something else' if head else 'an empty file'
            raise InputError(path, f'expected an MCAP recording, found {found}')
        self._input.seek(0)
        super().__init__(self._input)
        self.complete = _has_footer(self._input)
        self._made, self._end = self._find_summary()

    def get_summary(self) -> Summary:
        """Schemas, channels, chunks and counts of the file."""
        return self._made

    def times(self, topic: str) -> np.ndarray:
        """Times of receipt (n,) [ns] of a topic, from the message indexes: no chunk is opened
        that has one."""
        channels = [c.id for c in self._made.channels.values() if c.topic == topic]
        found = [np.empty(0, np.int64)]
        for chunk in self._made.chunk_indexes:
            offsets = chunk.message_index_offsets
            if not offsets:
                found.append(self._times_inside(chunk, channels))
            found += [self._indexed_times(offsets[id_]) for id_ in channels if id_ in offsets]
        return np.sort(np.concatenate(found))

    def _indexed_times(self, offset: int) -> np.ndarray:
        self._input.seek(offset + 1)
        length = int.from_bytes(self._input.read(8), 'little')
        content = self._input.read(length)
        return np.frombuffer(content, '<i8', offset=6)[::2].astype(np.int64)

    def _times_inside(self, index: ChunkIndex, channels: list[int]) -> np.ndarray:
        stream = _stream(self._input, index.chunk_start_offset, index.chunk_length - 9)
        return np.array([
            record.log_time for record in breakup_chunk(Chunk.read(stream))
            if isinstance(record, Message) and record.channel_id in channels
        ], np.int64)

    def repair(self) -> None:
        """Replace an unfinished last record by the index that was never written."""
        if not self.complete:
            with self.path.open('r+b') as file:
                file.truncate(self._end)
                if chunks := self._made.chunk_indexes:
                    self._end += _complete_index(file, chunks[-1], self._end)
                file.seek(self._end)
                file.write(closing_bytes(self._made, self._end))

    def close(self) -> None:
        """Close the file."""
        self._input.close()

    def _find_summary(self) -> tuple[Summary, int]:
        if self.complete:
            try:
                summary = super().get_summary()
            except (McapError, ValueError, KeyError) as error:
                raise InputError(self.path, f'expected a sound MCAP index ({error})') from None
            if summary is not None and summary.statistics is not None and summary.channels:
                return summary, 0
        return _scan(self._input)


def _has_footer(file: BinaryIO) -> bool:
    size = file.seek(0, 2)
    if size < _FOOTER_BYTES + len(MAGIC):
        return False
    file.seek(-_FOOTER_BYTES, 2)
    tail = file.read()
    return tail[0] == Opcode.FOOTER and tail.endswith(MAGIC)


def _scan(file: BinaryIO) -> tuple[Summary, int]:
    """The summary that the whole records at the head of a file amount to, and where they end."""
    summary = empty_summary()
    chunk: ChunkIndex | None = None
    counts: dict[int, int] = {}
    end = len(MAGIC)
    for opcode, start, length in _records(file):
        if opcode == Opcode.MESSAGE_INDEX and chunk is not None:
            index = MessageIndex.read(_stream(file, start, length))
            chunk.message_index_offsets[index.channel_id] = start
            chunk.message_index_length += 9 + length
            counts[index.channel_id] = len(index.records)
        elif chunk is not None:
            _settle(file, summary, chunk, counts)
            chunk, counts = None, {}
        if opcode == Opcode.CHUNK:
            chunk = _chunk_index(file, start, length)
        elif opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
        else:
            _note(file, summary, opcode, start, length)
        end = start + 9 + length
    if chunk is not None:
        # Nothing whole follows it: its index may be short, its bytes may never have got to disk.
        end = chunk.chunk_start_offset + chunk.chunk_length
        chunk.message_index_offsets, chunk.message_index_length = {}, 0
        try:
            _settle(file, summary, chunk, {})
        except (ValueError, McapError, zstandard.ZstdError):
            end = chunk.chunk_start_offset
    return summary, end


def _complete_index(file: BinaryIO, index: ChunkIndex, end: int) -> int:
    """Write the message index of the last chunk at `end` if it has none; its length."""
    if index.message_index_offsets:
        return 0
    stream, size = get_chunk_data_stream(Chunk.read(_stream(
        file, index.chunk_start_offset, index.chunk_length - 9)))
    found: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    while stream.count < size:
        offset, opcode, length = stream.count, stream.read1(), stream.read8()
        if opcode == Opcode.MESSAGE:
            message = Message.read(stream, length)
            found[message.channel_id].append((message.log_time, offset))
        else:
            stream.read(length)
    file.seek(end)
    for channel, records in found.items():
        index.message_index_offsets[channel] = end + index.message_index_length
        block = bytes_of(MessageIndex(channel, records))
        index.message_index_length += file.write(block)
    return index.message_index_length


def _records(file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of the content of every whole record."""
    size = file.seek(0, 2)
    position = len(MAGIC)
    while position + 9 <= size:
        file.seek(position)
        head = file.read(9)
        opcode, length = head[0], int.from_bytes(head[1:], 'little')
        if not opcode or position + 9 + length > size:
            return
        yield opcode, position, length
        position += 9 + length


def _stream(file: BinaryIO, start: int, length: int) -> ReadDataStream:
    file.seek(start + 9)
    return ReadDataStream(BytesIO(file.read(length)))


def _chunk_index(file: BinaryIO, start: int, length: int) -> ChunkIndex:
    file.seek(start + 9)
    stream = ReadDataStream(file)
    first, last, size = stream.read8(), stream.read8(), stream.read8()
    stream.read4()
    compression = stream.read_prefixed_string()
    return ChunkIndex(
        chunk_length=9 + length, chunk_start_offset=start, compression=compression,
        compressed_size=stream.read8(), message_start_time=first, message_end_time=last,
        message_index_offsets={}, message_index_length=0, uncompressed_size=size,
    )


def _note(file: BinaryIO, summary: Summary, opcode: int, start: int, length: int) -> None:
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(_stream(file, start, length))
        summary.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(_stream(file, start, length))
        summary.channels[channel.id] = channel
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(_stream(file, start, length))
        summary.attachment_indexes.append(attachment_index(attachment, start, 9 + length))
    elif opcode == Opcode.METADATA:
        name = Metadata.read(_stream(file, start, length)).name
        summary.metadata_indexes.append(MetadataIndex(start, 9 + length, name))


def _settle(
    file: BinaryIO, summary: Summary, index: ChunkIndex, counts: dict[int, int],
) -> None:
    """Enter a chunk, looking inside where its message index or its channels are not outside."""
    if not counts or not counts.keys() <= summary.channels.keys():
        counts = {}
        for record in breakup_chunk(Chunk.read(_stream(
                file, index.chunk_start_offset, index.chunk_length - 9))):
            if isinstance(record, Schema):
                summary.schemas[record.id] = record
            elif isinstance(record, Channel):
                summary.channels[record.id] = record
            elif isinstance(record, Message):
                counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
    count_chunk(summary, index, counts)
    summary.chunk_indexes.append(index)
