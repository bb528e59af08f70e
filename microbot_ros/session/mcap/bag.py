"""`metadata.yaml`, which rosbag2 reads before it opens the files of a recording."""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from mcap.summary import Summary

METADATA_FILE = 'metadata.yaml'


@cache
def typestore() -> Any:
    """Return the message definitions of ROS 2 Jazzy.

    Returns
    -------
    object
        Typestore of rosbags.
    """
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def whole(data: bytes, msgtype: str) -> bytes:
    """Return the serialised `data` of a message of type `msgtype` without trailing bytes.

    rclpy reserves memory by an estimate and may return more than the message.

    Parameters
    ----------
    data : bytes
        The serialised message.
    msgtype : str
        Type of the messages, such as 'sensor_msgs/msg/Image'.

    Returns
    -------
    bytes
        The message.
    """
    definition = typestore().get_msgdef(msgtype)
    read = definition.deserialize_cdr_le if data[1] & 1 else definition.deserialize_cdr_be
    _, end = read(data[4:], 0, definition.cls, typestore())
    return data[:4 + end]


def metadata_text(summaries: dict[Path, Summary]) -> str:
    """Return the content of `metadata.yaml` for the files of a recording, `summaries` in order.

    Parameters
    ----------
    summaries : dict of Path to Summary
        Summary of each file.

    Returns
    -------
    str
        YAML.
    """
    counts: Counter[str] = Counter()
    types: dict[str, str] = {}
    for summary in summaries.values():
        for channel in summary.channels.values():
            types[channel.topic] = summary.schemas[channel.schema_id].name
            counts[channel.topic] += _statistics(summary).channel_message_counts.get(channel.id, 0)
    files = [
        {'path': path.name, **_extent([summary])} for path, summary in summaries.items()
    ]
    information = {
        'version': 9, 'storage_identifier': 'mcap',
        'relative_file_paths': [path.name for path in summaries],
        **_extent(list(summaries.values())),
        'topics_with_message_count': [
            {'topic_metadata': _topic(topic, types[topic]), 'message_count': counts[topic]}
            for topic in types
        ],
        'compression_format': '', 'compression_mode': '', 'files': files, 'custom_data': None,
        'ros_distro': 'jazzy',
    }
    return yaml.safe_dump({'rosbag2_bagfile_information': information}, sort_keys=False)


def _topic(name: str, msgtype: str) -> dict[str, Any]:
    known = msgtype in typestore().types
    return {
        'name': name, 'type': msgtype, 'serialization_format': 'cdr', 'offered_qos_profiles': [],
        'type_description_hash': typestore().hash_rihs01(msgtype) if known else '',
    }


def _extent(summaries: list[Summary]) -> dict[str, Any]:
    filled = [stats for s in summaries if (stats := _statistics(s)).message_count]
    start = min((stats.message_start_time for stats in filled), default=0)
    end = max((stats.message_end_time for stats in filled), default=0)
    return {
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(stats.message_count for stats in filled),
    }


def _statistics(summary: Summary) -> Any:
    assert summary.statistics is not None
    return summary.statistics
