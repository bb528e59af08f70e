"""Recording while the loop runs: never waits for the disk, drops nothing essential."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Metadata, Schema

from microbot_ros.common.errors import InputError
from microbot_ros.session.mcap.bag import typestore
from microbot_ros.session.mcap.recording import is_topic
from microbot_ros.session.mcap.store import MIB, Priority, RecordedTopic, Store

MOST_QUEUED = {Priority.OVERLAY: 32 * MIB, Priority.FRAME: 256 * MIB, Priority.DATA: 512 * MIB}
"""Choice: bytes in memory from which a class of messages is dropped. Frames of 640×480 at 60 Hz
fill theirs in 14 s."""
LEAST_FREE = {Priority.OVERLAY: 1024 * MIB, Priority.FRAME: 256 * MIB, Priority.DATA: 0}
"""Choice: bytes free on disk below which a class of messages is dropped; data never are."""
_FRAMES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
_PERIOD, _NICENESS = 0.05, 5  # choices: time between two drains [s], niceness of the thread


@dataclass(frozen=True)
class RecorderStatus:
    """Status of a recording; `problem` is '' or one sentence.

    Messages by topic: `counts` taken, `dropped` lost. `bytes_written` to disk, `queued_bytes` in
    memory, `free_bytes` on the disk.
    """

    counts: dict[str, int]
    dropped: dict[str, int]
    bytes_written: int
    queued_bytes: int
    free_bytes: int
    problem: str


class RecordingWriter:
    """Recording of serialised ROS messages in rosbag2's MCAP layout, in a new or empty `folder`.

    `write` only queues; a separate thread compresses and stores. Queued messages are on disk
    within a second, so that a crash loses no more. If the disk is slow or full, overlays are
    dropped first, then frames; other messages stay in memory until the disk takes them, up to 512
    MiB: hours of tracks and commands. Dropped messages are counted. The folder holds
    `<name>_0.mcap`, `<name>_1.mcap`, …, and at the end `metadata.yaml`.

    Parameters
    ----------
    folder : str or Path
        The folder.
    """

    def __init__(self, folder: str | Path) -> None:
        folder = Path(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise InputError(folder, 'expected a new or empty folder to record to')
            self._store = Store(folder)
        except OSError as error:
            problem = f'expected a folder to record to ({error.strerror})'
            raise InputError(folder, problem) from None
        self._lock = threading.Lock()
        self._queue: deque[tuple[RecordedTopic, int, bytes] | Attachment | Metadata] = deque()
        self._queued_bytes = 0
        self._dropped: Counter[str] = Counter()
        self._topics: dict[str, RecordedTopic] = {}
        self._schemas: dict[str, Schema] = {}
        self._failure = ''
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name='recording', daemon=True)
        self._thread.start()

    def write(self, topic: str, msgtype: str, t_ns: int, data: bytes) -> None:
        """Queue one message of `topic` (with the leading slash) and type `msgtype`.

        `t_ns` [ns] is the time of receipt, `data` the CDR bytes. Raises ValueError for a type that
        ROS 2 Jazzy does not define, RuntimeError after `close`.

        Parameters
        ----------
        topic : str
            Name of the topic.
        msgtype : str
            Type of the messages, such as 'sensor_msgs/msg/Image'.
        t_ns : int
            Time of receipt [ns].
        data : bytes
            The serialised message.
        """
        if self._closing.is_set():
            raise RuntimeError('the recording is closed')
        with self._lock:
            entry = self._topics.get(topic) or self._declare(topic, msgtype)
            if self._failure or self._unaffordable(entry.priority):
                self._dropped[topic] += 1
                return
            self._queue.append((entry, t_ns, data))
            self._queued_bytes += len(data)

    def attach(self, name: str, content: str | bytes) -> None:
        """Store a file `name` with this `content` in the recording, such as `rig.yaml`.

        Parameters
        ----------
        name : str
            Name of the file.
        content : str or bytes
            Content of the file.
        """
        now = time.time_ns()
        data = content.encode() if isinstance(content, str) else content
        media = 'text/plain' if isinstance(content, str) else 'application/octet-stream'
        with self._lock:
            self._queue.append(Attachment(now, now, name, media, data))

    def describe(self, name: str, entries: dict[str, str]) -> None:
        """Store `entries` under a `name` in the recording: conditions, versions, a title.

        Parameters
        ----------
        name : str
            Name of the set.
        entries : dict of str to str
            Values by key.
        """
        with self._lock:
            self._queue.append(Metadata(name, entries))

    def status(self) -> RecorderStatus:
        """Return counts and sizes so far.

        Returns
        -------
        RecorderStatus
            The status.
        """
        store = self._store
        with self._lock:
            dropped = dict(store.dropped + self._dropped)
            return RecorderStatus(
                dict(store.counts), dropped, store.bytes_written, self._queued_bytes,
                store.free_bytes, self._problem(dropped),
            )

    def close(self) -> None:
        """Store the queue, the indexes and `metadata.yaml`; `status` tells what failed."""
        self._closing.set()
        self._thread.join()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _declare(self, topic: str, msgtype: str) -> RecordedTopic:
        if msgtype not in typestore().types:
            raise ValueError(f'{topic}: ROS 2 Jazzy defines no message type {msgtype}')
        if msgtype not in self._schemas:
            text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
            number = len(self._schemas) + 1
            self._schemas[msgtype] = Schema(
                id=number, name=msgtype, encoding='ros2msg', data=text.encode(),
            )
        schema = self._schemas[msgtype]
        channel = Channel(
            len(self._topics) + 1, topic, 'cdr', {'offered_qos_profiles': ''}, schema.id,
        )
        priority = Priority.DATA
        if is_topic(topic, 'overlay/image_raw') or is_topic(topic, 'markers'):
            priority = Priority.OVERLAY
        elif msgtype in _FRAMES:
            priority = Priority.FRAME
        self._topics[topic] = RecordedTopic(schema, channel, priority)
        return self._topics[topic]

    def _unaffordable(self, priority: Priority) -> bool:
        waiting = self._queued_bytes + self._store.waiting_bytes
        return waiting > MOST_QUEUED[priority] or self._store.free_bytes < LEAST_FREE[priority]

    def _problem(self, dropped: dict[str, int]) -> str:
        if self._failure:
            return f'recording stopped: {self._failure}'
        lost = ', '.join(f'{count} of {topic}' for topic, count in sorted(dropped.items()))
        if self._store.refused:
            return (f'the disk rejects data ({self._store.refused}); '
                    f'{self._store.waiting_bytes / MIB:.0f} MiB wait in memory; dropped: '
                    f'{lost or "none"}')
        if self._unaffordable(Priority.OVERLAY):
            free = f'{self._store.free_bytes / MIB:.0f} MiB free'
            return f'disk slow or nearly full ({free}); dropped: {lost or "none"}'
        return f'dropped because the disk was full or slow: {lost}' if lost else ''

    def _run(self) -> None:
        # On Linux niceness applies to one thread, so that threads of the loop come first.
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        try:
            while not self._closing.wait(_PERIOD):
                self._drain()
                self._store.tick()
            self._drain()
            self._store.close(self._dropped)
        except Exception as error:
            self._failure = f'{type(error).__name__}: {error}'
            self._store.abandon()
            raise

    def _drain(self) -> None:
        while self._queue:
            item = self._queue.popleft()
            if isinstance(item, tuple):
                self._store.add(*item)
                with self._lock:
                    self._queued_bytes -= len(item[2])
            else:
                self._store.add_record(item)
