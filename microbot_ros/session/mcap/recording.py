"""Reading recordings: a rosbag2 folder or a single MCAP file, finished or cut off."""

from __future__ import annotations

import heapq
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common import strict_yaml
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import load_yaml, write_text
from microbot_ros.session.mcap.bag import METADATA_FILE, metadata_text, typestore
from microbot_ros.session.mcap.file import McapFile, Message

_FOREVER = 2**63  # later than any time of receipt [ns]


@dataclass(frozen=True)
class Topic:
    """`type` of a recorded topic and the `count` of its messages."""

    type: str
    count: int


class Recording:
    """Recording at `path`, open for reading; a context manager.

    `topics` by name; `start_ns` and `end_ns` are the times of receipt of the first and last
    message (0 without messages); `complete` is False for a recording that was cut off, of which
    every whole chunk is available. The index at the end of each file is used, or made from the
    chunks.

    Parameters
    ----------
    path : str or Path
        Recording folder or `.mcap` file, finished or cut off by a crash.

    Raises
    ------
    InputError
        If files are missing, empty, of another format, or of several recordings.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._files: list[McapFile] = []
        try:
            for path_ in _files(self.path):
                self._files.append(McapFile(path_))
            self.topics = self._find_topics()
        except BaseException:
            self.close()
            raise
        statistics = [
            found for file in self._files
            if (found := file.summary.statistics) and found.message_count
        ]
        self.start_ns = min((found.message_start_time for found in statistics), default=0)
        self.end_ns = max((found.message_end_time for found in statistics), default=0)
        self.complete = all(file.complete for file in self._files) and (
            self.path.is_file() or (self.path / METADATA_FILE).exists()
        )

    def topic(self, name: str, msgtype: str) -> str | None:
        """Return the recorded topic `name` in any namespace, or None.

        Raises InputError if there are several, or it has another type than `msgtype`.

        Parameters
        ----------
        name : str
            Name without namespace.
        msgtype : str
            Type of the messages, such as 'sensor_msgs/msg/Image'.

        Returns
        -------
        str or None
            Name with namespace, or None.
        """
        found = [topic for topic in self.topics if is_topic(topic, name)]
        if len(found) > 1:
            raise InputError(self.path, f'expected one topic {name}, found {", ".join(found)}')
        if found and self.topics[found[0]].type != msgtype:
            wrong = self.topics[found[0]].type
            raise InputError(self.path, f'expected {msgtype} on {found[0]}, found {wrong}')
        return found[0] if found else None

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """Yield messages of `topics` (None: all), `start_ns` <= t_ns < `end_ns`, as received.

        Lazy: only chunks that hold such messages are read. Raises InputError for damaged data.

        Parameters
        ----------
        topics : collection of str or None
            Names of topics; None for all.
        start_ns : int or None
            Beginning [ns]; None for that of the recording.
        end_ns : int or None
            End [ns], excluded; None for that of the recording.

        Yields
        ------
        Message
            The message.
        """
        low, high = start_ns or 0, _FOREVER if end_ns is None else end_ns
        yield from heapq.merge(
            *(file.messages(topics, low, high) for file in self._files), key=attrgetter('t_ns'),
        )

    def times(self, topic: str) -> np.ndarray:
        """Return times of receipt (n,) [ns] of a `topic`, ascending, without reading messages.

        Parameters
        ----------
        topic : str
            Name of the topic.

        Returns
        -------
        ndarray, shape (n,)
            Times [ns].
        """
        return np.sort(np.concatenate([file.times(topic) for file in self._files]))

    def decode(self, message: Message) -> Any:
        """Return the decoded `message` with NumPy arrays. Raises InputError if that fails.

        Parameters
        ----------
        message : Message
            The message.

        Returns
        -------
        object
            The decoded message.
        """
        if message.type not in typestore().types:
            raise InputError(self.path, f'{message.topic}: expected a type of ROS 2 Jazzy, '
                                        f'found {message.type}')
        try:
            return typestore().deserialize_cdr(message.data, message.type)
        except Exception as error:  # the generated decoder raises errors of many types
            raise InputError(self.path, f'{message.topic}: expected a {message.type} '
                                        f'({type(error).__name__})') from None

    def attachments(self) -> dict[str, bytes]:
        """Return the attached files by name.

        Returns
        -------
        dict of str to bytes
            Content by name.
        """
        return {
            record.name: record.data for file in self._files
            for record in file.attachments()
        }

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the named sets of keys and values.

        Returns
        -------
        dict[str, dict of str to str]
            Sets by name.
        """
        return {
            record.name: record.metadata for file in self._files
            for record in file.metadata()
        }

    def repair(self) -> None:
        """Write what a crash left unwritten: the index of the last file, `metadata.yaml`."""
        for file in self._files:
            file.repair()
        if self.path.is_dir():
            summaries = {file.path: file.summary for file in self._files}
            write_text(self.path / METADATA_FILE, metadata_text(summaries))
        self.complete = True

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _find_topics(self) -> dict[str, Topic]:
        topics: dict[str, Topic] = {}
        for file in self._files:
            summary = file.summary
            assert summary.statistics is not None
            for channel in summary.channels.values():
                if channel.message_encoding != 'cdr' or channel.schema_id not in summary.schemas:
                    raise InputError(file.path, 'expected a ROS 2 recording (CDR messages), '
                                     f'found {channel.message_encoding!r} on {channel.topic}')
                kind = summary.schemas[channel.schema_id].name
                earlier = topics.get(channel.topic, Topic(kind, 0))
                if earlier.type != kind:
                    raise InputError(file.path, f'expected {earlier.type} on {channel.topic} '
                                                  f'as in the file before, found {kind}')
                count = summary.statistics.channel_message_counts.get(channel.id, 0)
                topics[channel.topic] = Topic(kind, earlier.count + count)
        return topics



def kept_parameters(path: Path, kept: Mapping[str, bytes], node: str) -> dict[str, Any]:
    """Return the parameters of a `node` in the files `kept` inside the recording at `path`.

    Empty where none were kept. Raises InputError for a file that is not what the recorder writes.

    Parameters
    ----------
    path : Path
        The recording, for messages.
    kept : mapping of str to bytes
        Attachments by name.
    node : str
        Name of the node.

    Returns
    -------
    dict of str to object
        Values by name.
    """
    try:
        text = kept.get(f'parameters/{node}.yaml', b'').decode()
        content = strict_yaml.load(text)[1] or {}
        values: dict[str, Any] = dict(content.get(node, {}).get('ros__parameters', {}))
    except (strict_yaml.YamlError, ValueError, TypeError, AttributeError):
        raise InputError(path, f'expected the parameters of {node} in it') from None
    if not all(isinstance(name, str) and Path(name).name == name for name in values):
        raise InputError(path, f'expected names of parameters of {node} in it')
    return values


def is_recording(path: Path) -> bool:
    """Return whether `path` is a recording rather than a folder of CSV files.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    bool
        Whether it is.
    """
    return path.is_file() or (path / METADATA_FILE).exists() or any(path.glob('*.mcap'))


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.exists():
        raise InputError(path, 'expected a recording, found nothing')
    if (path / METADATA_FILE).exists():
        return _listed_files(path / METADATA_FILE)
    files = sorted(path.glob('*.mcap'), key=_segment_number)
    # A power cut can leave an empty file.
    files = [file for file in files if file.stat().st_size] or files
    if not files:
        hint = '; sqlite3 bags must be converted first' if any(path.glob('*.db3')) else ''
        raise InputError(path, f'expected MCAP files, found none{hint}')
    names = sorted({re.sub(r'_\d+$', '', file.stem) for file in files})
    if len(names) > 1:
        raise InputError(path, f'expected one recording, found files of {", ".join(names)}')
    return files


def _listed_files(metadata: Path) -> list[Path]:
    try:
        content = load_yaml(metadata)[1]
        information = content['rosbag2_bagfile_information']
        storage = information['storage_identifier']
        files = [metadata.parent / name for name in information['relative_file_paths']]
    except (KeyError, TypeError):
        raise InputError(metadata, 'expected the metadata of a rosbag2 recording') from None
    if storage != 'mcap':
        raise InputError(metadata, f'expected an MCAP recording, found {storage}')
    for file in files:
        if not file.is_file():
            raise InputError(metadata, f'expected the file {file.name} beside it')
    return files


def _segment_number(path: Path) -> tuple[int, str]:
    match = re.search(r'_(\d+)$', path.stem)
    return (int(match.group(1)) if match else 0), path.stem


def is_topic(topic: str, name: str) -> bool:
    """Return whether a recorded `topic` is `name` in any namespace.

    '/particles' and '/rig/particles' are both 'particles'.

    Parameters
    ----------
    topic : str
        Name with namespace.
    name : str
        Name without namespace.

    Returns
    -------
    bool
        Whether it is.
    """
    return f'/{topic}'.endswith(f'/{name}')
