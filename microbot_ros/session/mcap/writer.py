"""One MCAP file while it is written: whole records appended, an index at the end."""

from __future__ import annotations

import fcntl
import os
import struct
import zlib
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.summary import Summary

from microbot_ros.session.mcap.chunk import ClosedChunk

MAGIC = b'\x89MCAP0\r\n'


class McapWriter:
    """MCAP file at `path` that is readable up to its last record at any moment.

    Every method appends whole records directly or, if the disk refuses, raises OSError and leaves
    the file as it was.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.summary = empty_summary()
        self.size = 0
        self._file = path.open('xb', buffering=0)
        with suppress(OSError):  # some network drives have no locks
            fcntl.flock(self._file, fcntl.LOCK_EX)  # for as long as the process lives
        header = Header('ros2', f'microbot_ros {version("microbot_ros")}')
        try:
            self._append(MAGIC + bytes_of(header))
        except OSError:
            self.abandon()
            path.unlink()
            raise

    def add_channel(self, schema: Schema, channel: Channel) -> None:
        """Declare a topic, its `schema` and `channel`, before the first chunk that holds it.

        Parameters
        ----------
        schema : Schema
            Schema of the topic.
        channel : Channel
            Channel of the topic.
        """
        # Outside the chunks, so that a cut-off file can be indexed without decompressing it.
        new = schema.id not in self.summary.schemas
        self._append((bytes_of(schema) if new else b'') + bytes_of(channel))
        self.summary.schemas[schema.id] = schema
        self.summary.channels[channel.id] = channel

    def add_chunk(self, closed: ClosedChunk) -> None:
        """Append a `closed` chunk and the index of its messages.

        Parameters
        ----------
        closed : ClosedChunk
            The chunk.
        """
        chunk = closed.chunk
        start, head = self.size, chunk_head(chunk)
        length = len(head) + len(chunk.data)
        offsets, indexes = {}, b''
        for index in closed.indexes:
            offsets[index.channel_id] = start + length + len(indexes)
            indexes += bytes_of(index)
        self._append(head, chunk.data, indexes)
        self.summary.chunk_indexes.append(ChunkIndex(
            chunk_length=length, chunk_start_offset=start, compression=chunk.compression,
            compressed_size=len(chunk.data), message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time, message_index_offsets=offsets,
            message_index_length=len(indexes), uncompressed_size=chunk.uncompressed_size,
        ))
        counts = {index.channel_id: len(index.records) for index in closed.indexes}
        count_messages(
            self.summary, chunk.message_start_time, chunk.message_end_time, counts)

    def add_attachment(self, record: Attachment) -> None:
        """Append an attached file `record`.

        Parameters
        ----------
        record : Attachment
            The record.
        """
        start, block = self.size, bytes_of(record)
        self._append(block)
        self.summary.attachment_indexes.append(attachment_index(record, start, len(block)))

    def add_metadata(self, record: Metadata) -> None:
        """Append a `record` of named keys and values.

        Parameters
        ----------
        record : Metadata
            The record.
        """
        start, block = self.size, bytes_of(record)
        self._append(block)
        self.summary.metadata_indexes.append(MetadataIndex(start, len(block), record.name))

    def sync(self) -> None:
        """Return when all written data would survive a power cut."""
        os.fdatasync(self._file.fileno())
        # Drop it from the page cache, where it would displace data that is in use.
        os.posix_fadvise(self._file.fileno(), 0, self.size, os.POSIX_FADV_DONTNEED)

    def finish(self) -> None:
        """Append the summary, by which readers find everything at once, and close the file."""
        try:
            self._append(closing_bytes(self.summary, self.size))
            self.sync()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is: readable, without an index."""
        self._file.close()

    def _append(self, *blocks: bytes) -> None:
        try:
            for block in blocks:
                rest = memoryview(block)
                while rest:
                    rest = rest[self._file.write(rest):]
        except OSError:
            self._file.truncate(self.size)
            self._file.seek(self.size)
            raise
        self.size += sum(map(len, blocks))


def empty_summary() -> Summary:
    """Return the summary of a file without records.

    Returns
    -------
    Summary
        The summary.
    """
    summary = Summary()
    summary.statistics = Statistics(
        attachment_count=0, channel_count=0, channel_message_counts={}, chunk_count=0,
        message_count=0, message_end_time=0, message_start_time=0, metadata_count=0,
        schema_count=0,
    )
    return summary


def attachment_index(record: Attachment, start: int, length: int) -> AttachmentIndex:
    """Return the summary entry of an attachment `record` of `length` bytes at byte `start`.

    Parameters
    ----------
    record : Attachment
        The record.
    start : int
        First byte of the record.
    length : int
        Length of the record [bytes].

    Returns
    -------
    AttachmentIndex
        The entry.
    """
    return AttachmentIndex(
        offset=start, length=length, log_time=record.log_time, create_time=record.create_time,
        data_size=len(record.data), name=record.name, media_type=record.media_type,
    )


def count_messages(summary: Summary, start: int, end: int, counts: dict[int, int]) -> None:
    """Add messages received from `start` to `end` [ns], `counts` by channel, to a `summary`.

    Parameters
    ----------
    summary : Summary
        Summary of the file.
    start : int
        Time of the first message [ns].
    end : int
        Time of the last message [ns].
    counts : dict of int to int
        Messages by channel.
    """
    statistics = summary.statistics
    assert statistics is not None
    first = not statistics.message_count
    statistics.message_start_time = start if first else min(statistics.message_start_time, start)
    statistics.message_end_time = max(statistics.message_end_time, end)
    statistics.message_count += sum(counts.values())
    totals = statistics.channel_message_counts
    for channel, count in counts.items():
        totals[channel] = totals.get(channel, 0) + count


def closing_bytes(summary: Summary, start: int) -> bytes:
    """Return all bytes after the data of an MCAP file whose data end at byte `start`.

    Parameters
    ----------
    summary : Summary
        Summary of the file.
    start : int
        First byte after the data.

    Returns
    -------
    bytes
        The bytes.
    """
    statistics = summary.statistics
    assert statistics is not None
    statistics.schema_count = len(summary.schemas)
    statistics.channel_count = len(summary.channels)
    statistics.chunk_count = len(summary.chunk_indexes)
    statistics.attachment_count = len(summary.attachment_indexes)
    statistics.metadata_count = len(summary.metadata_indexes)
    data_end = bytes_of(DataEnd(0))
    start += len(data_end)
    groups = {
        Opcode.SCHEMA: summary.schemas.values(), Opcode.CHANNEL: summary.channels.values(),
        Opcode.STATISTICS: [statistics], Opcode.CHUNK_INDEX: summary.chunk_indexes,
        Opcode.ATTACHMENT_INDEX: summary.attachment_indexes,
        Opcode.METADATA_INDEX: summary.metadata_indexes,
    }
    block, offsets = b'', b''
    for opcode, records in groups.items():
        group = b''.join(bytes_of(record) for record in records)
        if group:
            offsets += bytes_of(SummaryOffset(opcode, start + len(block), len(group)))
        block += group
    footer = bytes_of(Footer(start, start + len(block), 0))
    crc = zlib.crc32(block + offsets + footer[:-4])
    return data_end + block + offsets + footer[:-4] + crc.to_bytes(4, 'little') + MAGIC


def chunk_head(chunk: Chunk) -> bytes:
    """Return a `chunk` record up to its data, which are too large to be copied into it.

    Parameters
    ----------
    chunk : Chunk
        The chunk.

    Returns
    -------
    bytes
        The bytes.
    """
    kind = chunk.compression.encode()
    fields = struct.pack(
        f'<QQQII{len(kind)}sQ', chunk.message_start_time, chunk.message_end_time,
        chunk.uncompressed_size, chunk.uncompressed_crc, len(kind), kind, len(chunk.data))
    return struct.pack('<BQ', Opcode.CHUNK, len(fields) + len(chunk.data)) + fields


def bytes_of(record: McapRecord) -> bytes:
    """Return the bytes of a `record` in a file.

    Parameters
    ----------
    record : McapRecord
        The record.

    Returns
    -------
    bytes
        The bytes.
    """
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
