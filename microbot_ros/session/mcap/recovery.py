"""Index of an MCAP file that a crash left without one, made from its data."""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from io import BytesIO
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    ChunkIndex,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.summary import Summary

from microbot_ros.session.mcap.records import (
    RecordPlace,
    chunk_data,
    chunk_messages,
    chunk_records,
    file_records,
    stream_at,
)
from microbot_ros.session.mcap.writer import (
    MAGIC,
    attachment_index,
    bytes_of,
    count_messages,
    empty_summary,
)

BROKEN = (McapError, zstandard.ZstdError, struct.error, ValueError, LookupError,
          OverflowError, MemoryError)
"""Errors raised by reading a damaged chunk."""


def recover_summary(file: BinaryIO) -> tuple[Summary, int]:
    """Return the summary of the whole records at the start of a `file`, and where they end.

    Only the last chunk is opened, and those of writers that keep channels inside.

    Parameters
    ----------
    file : BinaryIO
        The file.

    Returns
    -------
    tuple[Summary, int]
        The summary, and the end of the records [bytes].
    """
    summary = empty_summary()
    chunk: ChunkIndex | None = None
    counts: dict[int, int] = {}
    end = len(MAGIC)
    for place in file_records(file):
        if place.opcode == Opcode.MESSAGE_INDEX and chunk is not None:
            index = MessageIndex.read(stream_at(file, place.start))
            chunk.message_index_offsets[index.channel_id] = place.start
            chunk.message_index_length += place.end - place.start
            counts[index.channel_id] = len(index.records)
        elif chunk is not None:
            _settle(file, summary, chunk, counts)
            chunk, counts = None, {}
        if place.opcode == Opcode.CHUNK:
            chunk = _chunk_index(file, place)
        elif place.opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
        else:
            _note(file, summary, place)
        end = place.end
    if chunk is not None:
        # No whole record follows: its index may be short, its bytes may not be on disk.
        end = chunk.chunk_start_offset + chunk.chunk_length
        chunk.message_index_offsets, chunk.message_index_length = {}, 0
        try:
            _settle(file, summary, chunk, {})
        except BROKEN:
            end = chunk.chunk_start_offset
    return summary, end


def complete_index(file: BinaryIO, index: ChunkIndex, end: int) -> int:
    """Write the message index of the last chunk `index` to a `file` at `end`.

    Return the length.

    Parameters
    ----------
    file : BinaryIO
        The file.
    index : ChunkIndex
        Index of the chunk.
    end : int
        Byte at which to write.

    Returns
    -------
    int
        Length [bytes].
    """
    if index.message_index_offsets:
        return 0
    found: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    for channel, t_ns, start, _, _ in chunk_messages(chunk_data(file, index)):
        found[channel].append((t_ns, start))
    file.seek(end)
    for channel, records in found.items():
        index.message_index_offsets[channel] = end + index.message_index_length
        index.message_index_length += file.write(bytes_of(MessageIndex(channel, records)))
    return index.message_index_length


def _chunk_index(file: BinaryIO, place: RecordPlace) -> ChunkIndex:
    file.seek(place.content)
    stream = ReadDataStream(file)
    first, last, size = stream.read8(), stream.read8(), stream.read8()
    stream.read4()
    compression = stream.read_prefixed_string()
    return ChunkIndex(
        chunk_length=place.end - place.start, chunk_start_offset=place.start,
        compression=compression, compressed_size=stream.read8(), message_start_time=first,
        message_end_time=last, message_index_offsets={}, message_index_length=0,
        uncompressed_size=size,
    )


def _note(file: BinaryIO, summary: Summary, place: RecordPlace) -> None:
    """Add a record outside of chunks to the summary."""
    stream, length = stream_at(file, place.start), place.end - place.start
    if place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        _declare(summary, place.opcode, stream)
    elif place.opcode == Opcode.MESSAGE:
        message = Message.read(stream, place.end - place.content)
        count_messages(summary, message.log_time, message.log_time, {message.channel_id: 1})
    elif place.opcode == Opcode.ATTACHMENT:
        record = Attachment.read(stream)
        summary.attachment_indexes.append(attachment_index(record, place.start, length))
    elif place.opcode == Opcode.METADATA:
        name = Metadata.read(stream).name
        summary.metadata_indexes.append(MetadataIndex(place.start, length, name))


def _declare(summary: Summary, opcode: int, stream: ReadDataStream) -> None:
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        summary.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        summary.channels[channel.id] = channel


def _settle(
    file: BinaryIO, summary: Summary, index: ChunkIndex, counts: dict[int, int],
) -> None:
    """Add a chunk, decompressed if its message index or its channels are not outside."""
    if not counts or not counts.keys() <= summary.channels.keys():
        data = chunk_data(file, index)
        for place in chunk_records(data):
            if place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                content = ReadDataStream(BytesIO(data[place.content:place.end]))
                _declare(summary, place.opcode, content)
        counts = Counter(channel for channel, *_ in chunk_messages(data))
    summary.chunk_indexes.append(index)
    count_messages(summary, index.message_start_time, index.message_end_time, counts)
