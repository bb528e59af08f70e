"""Files of a growing recording: chunks by priority, segments, a disk that may refuse."""

from __future__ import annotations

import shutil
import time
from collections import Counter, deque
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from mcap.records import Attachment, Channel, Metadata, Schema

from microbot_ros.common.files import write_text
from microbot_ros.session.mcap.bag import METADATA_FILE, metadata_text
from microbot_ros.session.mcap.chunk import ChunkBuilder, ClosedChunk
from microbot_ros.session.mcap.writer import McapWriter

MIB = 2**20  # bytes of a mebibyte, by definition
CHUNK_BYTES = 4 * MIB  # choice: as the largest chunks of rosbag2
FLUSH_SECONDS = 0.5
"""Choice: age at which a chunk is written, half of the second that a crash may cost."""
SYNC_SECONDS = 0.4
"""Choice: time between two fdatasync. After every chunk, a busy disk would block twenty times a
second.
"""
SEGMENT_BYTES = 4096 * MIB
"""Choice: size from which a new file is begun, which bounds what one file can lose."""
SEGMENT_SECONDS = 600.0
"""Choice: duration [s] from which a new file is begun, which bounds what one file can lose."""


class Priority(IntEnum):
    """Order in which messages are dropped when the disk cannot keep up; data never are."""

    OVERLAY = 0  # first to be dropped
    FRAME = 1  # dropped second
    DATA = 2  # never dropped


@dataclass(frozen=True)
class RecordedTopic:
    """A recorded topic: its `schema` and `channel` records, and its priority."""

    schema: Schema
    channel: Channel
    priority: Priority


class Store:
    """Files in `folder` with separate chunks for each priority.

    Tracks can thus be read without decompressing frames, and refused chunks be dropped by
    priority. Not thread-safe: one thread stores, others may read the public attributes.

    Parameters
    ----------
    folder : Path
        The folder.
    """

    def __init__(self, folder: Path) -> None:
        self.counts: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self.refused = ''
        self.waiting_bytes = 0
        self.free_bytes = shutil.disk_usage(folder).free
        self._folder = folder
        self._synced = 0.0
        self._writers: list[McapWriter] = []
        self._next_segment()
        self._topics: dict[int, RecordedTopic] = {}
        self._builders = {priority: ChunkBuilder() for priority in Priority}
        self._opened = dict.fromkeys(Priority, 0.0)
        self._waiting: deque[tuple[Priority, ClosedChunk | Attachment | Metadata]] = deque()

    @property
    def bytes_written(self) -> int:
        """Bytes in all files so far."""
        return sum(segment.size for segment in self._writers)

    def add(self, topic: RecordedTopic, t_ns: int, data: bytes) -> None:
        """Add a message of `topic`, received at `t_ns` [ns] with CDR `data`.

        It is on disk after the next `tick` that finds its chunk due.

        Parameters
        ----------
        topic : RecordedTopic
            The topic.
        t_ns : int
            Time of receipt [ns].
        data : bytes
            The serialised message.
        """
        builder = self._builders[topic.priority]
        if not builder.size:
            self._opened[topic.priority] = time.monotonic()
        self._topics[topic.channel.id] = topic
        builder.add(topic.channel.id, t_ns, data)
        if builder.size >= CHUNK_BYTES:
            self._flush(topic.priority)

    def add_record(self, record: Attachment | Metadata) -> None:
        """Write an attachment or metadata `record` at once.

        Parameters
        ----------
        record : Attachment or Metadata
            The record.
        """
        self._waiting.append((Priority.DATA, record))
        self._write()

    def tick(self) -> None:
        """Write due chunks, retry refused ones, and begin a new file when it is time."""
        now = time.monotonic()
        self.free_bytes = shutil.disk_usage(self._folder).free
        for priority, builder in self._builders.items():
            if builder.size and now - self._opened[priority] >= FLUSH_SECONDS:
                self._flush(priority)
        self._write()
        self._sync()
        old = now - self._segment_began >= SEGMENT_SECONDS
        if (old or self._writer.size >= SEGMENT_BYTES) and not self._waiting:
            self._roll()

    def close(self, lost: Counter[str]) -> None:
        """Write all remaining data, the indexes and `metadata.yaml`.

        `lost` counts messages dropped before they were added, by topic.

        Parameters
        ----------
        lost : Counter[str]
            Dropped messages by topic.
        """
        for priority in Priority:
            self._flush(priority)
        if dropped := self.dropped + lost:
            self.add_record(Metadata('dropped', {name: str(n) for name, n in dropped.items()}))
        try:
            self._writer.finish()
            text = metadata_text({s.path: s.summary for s in self._writers})
            write_text(self._folder / METADATA_FILE, text)
        except OSError as error:
            self.refused = error.strerror or str(error)
        self._drop(list(Priority))

    def abandon(self) -> None:
        """Leave the files as they are."""
        self._writer.abandon()

    def _flush(self, priority: Priority) -> None:
        if self._builders[priority].size:
            self._waiting.append((priority, self._builders[priority].close()))
            self._write()

    def _write(self) -> None:
        while self._waiting:
            try:
                self._write_one(self._waiting[0][1])
            except OSError as error:
                self.refused = error.strerror or str(error)
                self._drop([Priority.OVERLAY, Priority.FRAME])
                break
            self._waiting.popleft()
            self.refused = ''
        self.waiting_bytes = sum(
            len(item.chunk.data) for _, item in self._waiting if isinstance(item, ClosedChunk))

    def _sync(self) -> None:
        if time.monotonic() - self._synced < SYNC_SECONDS:
            return
        try:
            self._writer.sync()
        except OSError as error:
            self.refused = error.strerror or str(error)
        self._synced = time.monotonic()

    def _write_one(self, item: ClosedChunk | Attachment | Metadata) -> None:
        if isinstance(item, Attachment):
            self._writer.add_attachment(item)
        elif isinstance(item, Metadata):
            self._writer.add_metadata(item)
        else:
            for index in item.indexes:
                if index.channel_id not in self._writer.summary.channels:
                    topic = self._topics[index.channel_id]
                    self._writer.add_channel(topic.schema, topic.channel)
            self._writer.add_chunk(item)
            self.counts.update(self._by_topic(item))

    def _drop(self, priorities: list[Priority]) -> None:
        """Drop, and count, waiting chunks of these priorities."""
        for priority, item in self._waiting:
            if priority in priorities and isinstance(item, ClosedChunk):
                self.dropped.update(self._by_topic(item))
        self._waiting = deque(entry for entry in self._waiting if entry[0] not in priorities)

    def _by_topic(self, closed: ClosedChunk) -> dict[str, int]:
        return {
            self._topics[index.channel_id].channel.topic: len(index.records)
            for index in closed.indexes
        }

    def _next_segment(self) -> None:
        name = f'{self._folder.resolve().name}_{len(self._writers)}.mcap'
        self._writer = McapWriter(self._folder / name)
        self._writers.append(self._writer)
        self._segment_began = time.monotonic()

    def _roll(self) -> None:
        full = self._writer
        try:
            self._next_segment()
            full.finish()
        except OSError as error:
            self.refused = error.strerror or str(error)
