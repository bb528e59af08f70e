"""Records of an MCAP file and of its chunks, in sequence."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex

from microbot_ros.session.mcap.writer import MAGIC

_LARGEST_CHUNK = 2**30  # choice: 1 GiB, beyond which a file could fill the memory
_ALWAYS_READ = 2**26  # choice: 64 MiB, far above any writer's chunks
_DENSEST = 100
"""Choices: a chunk may hold 64 MiB in any file, and up to 1 GiB in a file of a hundredth of that.

Writers of rosbag2 make chunks of 1 to 4 MiB, this package smaller ones. A larger chunk is damaged
or made to fill the memory.
"""
_HEAD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<HIQQ')


class RecordPlace(NamedTuple):
    """Place of a record: its `opcode`, first byte `start`, and its `content` up to `end`."""

    opcode: int
    start: int
    content: int
    end: int


def file_records(file: BinaryIO) -> Iterator[RecordPlace]:
    """Yield every whole record of a `file`, up to the first unfinished one.

    Parameters
    ----------
    file : BinaryIO
        The file.

    Yields
    ------
    RecordPlace
        Place of the record.
    """
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
    """Yield every record of a chunk's decompressed `data`; struct.error if they are cut.

    Parameters
    ----------
    data : bytes
        Decompressed data of the chunk.

    Yields
    ------
    RecordPlace
        Place of the record.
    """
    position = 0
    while position < len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        end = position + _HEAD.size + length
        yield RecordPlace(opcode, position, position + _HEAD.size, end)
        position = end


def chunk_messages(data: bytes) -> Iterator[tuple[int, int, int, int, int]]:
    """Yield every message in a chunk's `data`.

    Channel, time [ns], start of its record, start and end of the serialised bytes.

    Parameters
    ----------
    data : bytes
        Decompressed data of the chunk.

    Yields
    ------
    tuple of int
        Channel, time [ns], start of the record, start and end of the bytes.
    """
    for opcode, start, content, end in chunk_records(data):
        if opcode == Opcode.MESSAGE:
            channel, _, t_ns, _ = _MESSAGE.unpack_from(data, content)
            yield channel, t_ns, start, content + _MESSAGE.size, end


def stream_at(file: BinaryIO, start: int) -> ReadDataStream:
    """Return the content of the record at byte `start` of a `file`, for the mcap package.

    Raises McapError for a record that does not lie inside the file.

    Parameters
    ----------
    file : BinaryIO
        The file.
    start : int
        First byte of the record.

    Returns
    -------
    ReadDataStream
        The content.
    """
    size = file.seek(0, 2)
    if not 0 <= start <= size - _HEAD.size:
        raise McapError(f'a record at byte {start} of {size}')
    file.seek(start)
    _, length = _HEAD.unpack(file.read(_HEAD.size))
    if length > size - start - _HEAD.size:
        raise McapError(f'a record of {length} bytes in a file of {size}')
    return ReadDataStream(BytesIO(file.read(length)))


def chunk_data(file: BinaryIO, index: ChunkIndex) -> bytes:
    """Return the decompressed content of a chunk at `index` of a `file`.

    Raises McapError if it is too large or its size is not the stated one.

    Parameters
    ----------
    file : BinaryIO
        The file.
    index : ChunkIndex
        Index of the chunk.

    Returns
    -------
    bytes
        The content.
    """
    chunk = Chunk.read(stream_at(file, index.chunk_start_offset))
    size, most = chunk.uncompressed_size, max(_ALWAYS_READ, _DENSEST * file.seek(0, 2))
    if size > min(most, _LARGEST_CHUNK):
        raise McapError(f'a chunk of {size} bytes')
    data = _decompressed(chunk.compression, chunk.data, size)
    if len(data) != size:
        raise McapError(f'a chunk that declares {size} bytes and has another length')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise McapError('a chunk with a wrong checksum')
    return data


def _decompressed(compression: str, data: bytes, size: int) -> bytes:
    """Return decompressed `data`, at most one byte more than `size`."""
    if compression == 'zstd':
        # As a stream, so that the size stated in the frame is not trusted.
        with zstandard.ZstdDecompressor(max_window_size=_LARGEST_CHUNK).stream_reader(
                data, read_across_frames=True) as stream:
            return bytes(stream.read(size + 1))
    if compression == 'lz4':
        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
        except RuntimeError as error:
            raise McapError(f'a chunk that is no lz4 frame ({error})') from None
    if compression:
        raise McapError(f"a chunk compressed by '{compression}'")
    return data
