"""The records of an MCAP file and of its chunks, one after the other."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex
from mcap.stream_reader import get_chunk_data_stream

from microbot_ros.session.mcap_writer import MAGIC

_LARGEST_CHUNK = 2**30
_HEAD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<HIQQ')


class RecordPlace(NamedTuple):
    """Where a record is: its kind, `opcode`, its first byte, `start`, and its `content` up to
    `end`.
    """

    opcode: int
    start: int
    content: int
    end: int


def file_records(file: BinaryIO) -> Iterator[RecordPlace]:
    """Every whole record of a file, up to the first that a crash left unfinished."""
    size = file.seek(0, 2)
    position = len(MAGIC)
    while position + _HEAD.size <= size:
        file.seek(position)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        end = position + _HEAD.size + length
        if not opcode or end > size:
            return
        yield RecordPlace(opcode, position, position + _HEAD.size, end)
        position = end


def chunk_records(data: bytes) -> Iterator[RecordPlace]:
    """Every record of a chunk's decompressed data; struct.error where they are cut."""
    position = 0
    while position < len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        end = position + _HEAD.size + length
        yield RecordPlace(opcode, position, position + _HEAD.size, end)
        position = end


def chunk_messages(data: bytes) -> Iterator[tuple[int, int, int, int, int]]:
    """Of every message in a chunk's data: channel, time [ns], start of its record, start and end
    of what was sent."""
    for opcode, start, content, end in chunk_records(data):
        if opcode == Opcode.MESSAGE:
            channel, _, t_ns, _ = _MESSAGE.unpack_from(data, content)
            yield channel, t_ns, start, content + _MESSAGE.size, end


def stream_at(file: BinaryIO, start: int) -> ReadDataStream:
    """The content of the record at byte `start` of a file, for the readers of the mcap package."""
    file.seek(start)
    _, length = _HEAD.unpack(file.read(_HEAD.size))
    return ReadDataStream(BytesIO(file.read(length)))


def chunk_data(file: BinaryIO, index: ChunkIndex) -> bytes:
    """The decompressed content of a chunk; McapError for one that no memory should hold."""
    chunk = Chunk.read(stream_at(file, index.chunk_start_offset))
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise McapError(f'a chunk of {chunk.uncompressed_size} bytes')
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(size)
