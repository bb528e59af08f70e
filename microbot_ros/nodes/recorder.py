"""Node `recorder`: topics of the graph to an MCAP recording, as they came off the wire."""

from __future__ import annotations

import array
import contextlib
import platform
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import yaml
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message
from std_srvs.srv import SetBool

from microbot_ros.common.errors import InputError
from microbot_ros.common.extras import lack, require
from microbot_ros.common.settings import setting
from microbot_ros.nodes.base.lifecycle import OK, WARN, RigNode
from microbot_ros.nodes.base.topics import CHANGES, TOPICS, type_name
from microbot_ros.nodes.client.parameter_collector import ParameterCollector

if TYPE_CHECKING:
    from microbot_ros.session.mcap.recorder import RecordingWriter

_FRAMES, _OVERLAY = 'camera/image_raw', 'overlay/image_raw'
_CONDITIONS = (
    'propulsion', 'radius_um', 'viscosity_mPa_s', 'temperature_K', 'reference_field_mT',
    'height_um')
"""Parameters of the node `model` that are kept with a session."""
_LIBRARIES = ('microbot_ros', 'ros-jazzy-rclpy', 'numpy', 'scipy', 'numba',
              'opencv-python-headless')


@dataclass(frozen=True)
class RecorderParameters:
    """Parameters of the node `recorder`."""

    recording: bool = setting(
        True, 'Record from the start; false: only after `~/record` is called.', read_only=True)
    folder: str = setting(
        '', 'Folder of the next recording; empty makes one in ./recordings named after the time.')
    topics: list[str] = setting(
        [], 'What to record; empty records frames, particles, goals, commands, currents, '
            'estimates and health, but not `overlay/image_raw`.', read_only=True)
    frame_every: int = setting(
        1, 'Record every n-th camera frame; 0 records none.', lower=0, upper=1000)
    title: str = setting(
        '', 'One line on what the next recording is of; set while one runs, what that is of.')
    notes: str = setting('', 'Further notes on the recording, before or during it.')
    attachments: list[str] = setting(
        [], 'Files kept inside the recording: protocol, photographs, calibrations.',
        read_only=True)


class RecorderNode(RigNode):
    """Node that hands serialised messages to the writer, whose own thread compresses and writes.

    `~/record` (std_srvs/SetBool) begins and ends a recording. Its title and notes are those of the
    parameters at the beginning, or set meanwhile. The recording also contains the parameters of
    every node, the files that they name, versions, and the offsets between the clocks.
    """

    Parameters: ClassVar[type] = RecorderParameters

    def setup(self) -> None:
        if not lack('mcap'):
            from microbot_ros.session.mcap.bag import typestore

            typestore()  # takes 0.1 s, in which frames would be lost
        self._writer: RecordingWriter | None = None
        self._subject: dict[str, str] = {}
        self._attachments = {
            Path(name).name: _content(name) for name in self.settings.attachments}
        for topic in self.settings.topics or set(TOPICS) - {_OVERLAY}:
            if topic not in TOPICS:
                known = ', '.join(TOPICS)
                raise InputError(self.get_name(), f'no topic {topic} to record; known: {known}')
            kind, qos = TOPICS[topic]
            self.subscribe(kind, topic, self._taker(topic), qos, raw=True)
        self._collector = ParameterCollector(self, self._keep_parameters)
        self.service(SetBool, '~/record', self._on_record)
        self.every(0.1, self._look_around)

    def take(self, changed: Mapping[str, Any], named: Collection[str]) -> str:
        # Title and notes that are set during a recording are kept; no text is removed.
        values: RecorderParameters = changed.get('', self.settings)
        writer: RecordingWriter | None = getattr(self, '_writer', None)
        for name in {'title', 'notes'} & {*named}:
            if (text := getattr(values, name)) and writer is not None:
                self._subject = {**self._subject, name: text}
                writer.describe('recording', self._subject)
        return ''

    def start(self) -> None:
        if problem := self.settings.recording and lack('mcap'):
            self.complain(f'not recording: {problem}')
        elif self.settings.recording:
            self._begin()

    def stop(self) -> None:
        writer, self._writer = getattr(self, '_writer', None), None
        if writer is not None:
            writer.describe('clocks at the end', self._clocks())
            writer.close()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        if self._writer is None:
            problem = lack('mcap')
            return (WARN, f'cannot record: {problem}', {}) if problem else (
                OK, 'not recording', {})
        status = self._writer.status()
        values: dict[str, object] = {
            'messages': sum(status.counts.values()), 'dropped': sum(status.dropped.values()),
            'written_MB': status.bytes_written / 1e6, 'queued_MB': status.queued_bytes / 1e6,
            'free_GB': status.free_bytes / 1e9,
            'recording_s': time.monotonic() - self._began, 'title': self._subject['title'],
            'parameters_of': ' '.join(sorted(self._collector.answered))}
        if status.problem:
            return WARN, status.problem, values
        return OK, f'recording to {self._folder}', values

    def _on_record(self, request: Any, response: Any) -> Any:
        response.success = self.active and request.data != (self._writer is not None)
        if not response.success:
            response.message = (f'already recording to {self._folder}'
                                if self._writer else 'not recording')
        elif request.data:
            try:
                self._begin()
                response.message = f'recording to {self._folder}'
            except InputError as error:
                response.success, response.message = False, str(error)
        else:
            self.stop()
            response.message = f'recorded {self._folder}'
        self._report()
        return response

    def _begin(self) -> None:
        values: RecorderParameters = self.settings
        folder = values.folder or f'recordings/{datetime.now():%Y-%m-%d_%H-%M-%S}'
        require('mcap')
        from microbot_ros.session.mcap.recorder import RecordingWriter

        writer = RecordingWriter(folder)
        self._subject = {'title': values.title, 'notes': values.notes}
        self._began = time.monotonic()
        writer.describe('recording', self._subject)
        writer.describe('clocks', self._clocks())
        writer.describe('versions', _versions())
        for name, content in self._attachments.items():
            writer.attach(name, content)
        self._folder, self._writer = folder, writer
        self._seen_frames = 0
        self._kept: set[str] = set()
        self._collector.begin()

    def _clocks(self) -> dict[str, str]:
        """Return the offsets from the machine's monotonic clock to ROS time and to UTC."""
        monotonic, ros = time.monotonic_ns(), self.get_clock().now().nanoseconds
        known = {'ros_minus_monotonic_ns': str(ros - monotonic)} if ros else {}
        return {**known, 'utc_minus_monotonic_ns': str(time.time_ns() - monotonic)}

    def _look_around(self) -> None:
        if self._writer is not None:
            self._collector.look()

    def _keep_parameters(self, node: str, values: dict[str, Any]) -> None:
        if self._writer is not None:
            keep_parameters(self._writer, node, values, self._kept)

    def _taker(self, topic: str) -> Callable[[bytes], None]:
        name, kind = self.resolve_topic_name(topic), type_name(TOPICS[topic][0])

        def take(data: bytes) -> None:
            now = self.get_clock().now().nanoseconds
            # Simulated time is 0 until the first message of its clock.
            if self._writer is None or not now:
                return
            if topic == _FRAMES and not self._wants_frame():
                return
            self._writer.write(name, kind, now, data)
            if topic == CHANGES:
                event = deserialize_message(data, ParameterEvent)
                _keep_files(self._writer, {one.name: parameter_value_to_python(one.value)
                                           for one in event.changed_parameters}, self._kept)
        return take

    def _wants_frame(self) -> bool:
        self._seen_frames += 1
        every = self.settings.frame_every
        return every > 0 and self._seen_frames % every == 0


def keep_parameters(writer: RecordingWriter, node: str, values: dict[str, Any],
                    kept: set[str]) -> None:
    """Attach a parameter file of a node to a recording, and the files that the parameters name.

    Parameters
    ----------
    writer : RecordingWriter
        Writer of the recording.
    node : str
        Name of the node.
    values : dict of str to object
        Parameters by name.
    kept : set of str
        Names of files that are attached already; new ones are added.
    """
    plain = {name: value.tolist() if isinstance(value, array.array) else value
             for name, value in values.items()}
    text = yaml.safe_dump({node: {'ros__parameters': plain}}, allow_unicode=True)
    writer.attach(f'parameters/{node}.yaml', text)
    _keep_files(writer, plain, kept)
    if node == 'model':
        writer.describe('session', {
            name: str(plain[name]) for name in _CONDITIONS if plain[name]})


def _keep_files(writer: RecordingWriter, values: dict[str, Any], kept: set[str]) -> None:
    """Attach every file that a parameter names, under the name that the parameter holds."""
    for name, value in values.items():
        if name.endswith('_file') and value and value not in kept:
            kept.add(value)
            with contextlib.suppress(InputError):  # the node itself reports the error
                writer.attach(value, _content(value))


def _content(name: str) -> bytes:
    try:
        return Path(name).read_bytes()
    except OSError as error:
        raise InputError(name, f'expected a file to attach ({error.strerror})') from None


def _versions() -> dict[str, str]:
    found = {'python': platform.python_version()}
    for name in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
