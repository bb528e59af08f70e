"""Replay of a recording through the present nodes, in the order in which they received it."""

from __future__ import annotations

import contextlib
import hashlib
import math
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from microbot_ros.common import settings
from microbot_ros.common.errors import InputError
from microbot_ros.control.plugins.policy import EXECUTED_FILE
from microbot_ros.control.recorded_worker import IN_TIME, RepeatingWorker
from microbot_ros.loop.allocation import AllocationStage, GateParameters
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.core import RELIABLE, Core
from microbot_ros.nodes.base.messages import MessageError
from microbot_ros.nodes.base.topics import TOPICS, type_name
from microbot_ros.nodes.controller import ControllerCore
from microbot_ros.nodes.model import ModelCore
from microbot_ros.nodes.tracker import TrackerCore
from microbot_ros.session.mcap.bag import whole
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording, is_topic, kept_parameters
from microbot_ros.session.replay.compare import Doubt
from microbot_ros.session.replay.log import (
    EXPIRE,
    LET_GO,
    LOG,
    PARAMETERS,
    Entry,
    Inputs,
    header_stamp_ns,
    order_of_receipt,
    read_log,
)
from microbot_ros.session.replay.playback import Source, open_source


class CoilCore(Core):
    """Core between the topics of the field and `coils/command`, without gate and amplifier."""

    Parameters = GateParameters
    frame = 'field/command'

    def connect(self) -> None:
        self._stage = AllocationStage(self.settings)
        self._wanted = self.publisher(JointState, 'coils/command')
        self.subscribe(Vector3Stamped, 'field/command', lambda message: self._answer(
            self._stage.step(messages.vector(message)), message))
        self.subscribe(TwistStamped, 'field/rotating', self._on_rotating)

    def _on_rotating(self, message: TwistStamped) -> None:
        field, angular_velocity = messages.rotating_field(message)
        if field.any() and angular_velocity.any():
            turning = self._stage.turn(field, angular_velocity)
            self._answer(turning.at(turning.start), message)
        else:
            self._answer(self._stage.step(field), message)

    def _answer(self, currents: np.ndarray, message: Any) -> None:
        self._wanted.publish(messages.currents(
            self._stage.coils.names, currents, message.header.stamp))


@dataclass(frozen=True)
class Stage:
    """A node that can be replayed.

    Attributes
    ----------
    node : str
        Its name.
    takes : tuple of str
        Topics that it receives, the one that it answers first.
    gives : tuple of str
        Topics that it publishes, that of its answer first.
    core : type[Core]
        Class of its core.
    """

    node: str
    takes: tuple[str, ...]
    gives: tuple[str, ...]
    core: type[Core]


STAGES = (
    Stage('tracker', ('camera/image_raw', 'field/applied', 'field/command', 'field/rotating'),
          ('particles', 'particles/poses'), TrackerCore),
    Stage('model', ('particles', 'field/applied', 'field/command', 'field/rotating'),
          ('model/state',), ModelCore),
    Stage('controller', ('model/state', 'goals', 'particle_goals', 'goal_pose', 'path',
                         'field/plan', 'joy'), ('field/command', 'field/rotating'),
          ControllerCore),
    Stage('coil_driver', ('field/command', 'field/rotating'), ('coils/command',), CoilCore),
)
"""Nodes whose answers follow from the recording, in the order of the graph."""


@dataclass(frozen=True)
class ReplayPlan:
    """Plan of a replay.

    Attributes
    ----------
    stages : tuple of Stage
        Nodes that are replayed.
    played : tuple of str
        Recorded topics that are played to them.
    namespace : str
        Namespace of the topics.
    """

    stages: tuple[Stage, ...]
    played: tuple[str, ...]
    namespace: str

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes, in order."""
        return tuple(stage.node for stage in self.stages)

    @property
    def answers(self) -> dict[str, tuple[str, ...]]:
        """Topics that each node publishes, as they are recorded, by node."""
        return {stage.node: tuple(f'{self.namespace}/{topic}' for topic in stage.gives)
                for stage in self.stages}


def plan_replay(source: Source, path: Path, nodes: Collection[str] = ()) -> ReplayPlan:
    """Return the plan of a replay.

    A tracker that received more frames than were recorded cannot give the same answers, and is not
    replayed unless it is named.

    Parameters
    ----------
    source : Source
        Recording.
    path : Path
        Its path, for messages.
    nodes : collection of str
        Names of the nodes; empty for all that were recorded.

    Returns
    -------
    ReplayPlan
        The plan.

    Raises
    ------
    InputError
        If there is nothing to replay.
    """
    by_role = {name: topic for topic in source.topics for stage in STAGES
               for name in (*stage.takes, *stage.gives) if is_topic(topic, name)}
    counts = {name: source.topics[topic].count for name, topic in by_role.items()}

    def reproducible(stage: Stage) -> bool:
        enough = stage.node != 'tracker' or counts.get('camera/image_raw', 0) >= counts.get(
            'particles', 0)
        answered = any(counts.get(topic) for topic in stage.gives)
        return bool(counts.get(stage.takes[0]) and answered and enough)

    stages = tuple(stage for stage in STAGES
                   if (stage.node in nodes if nodes else reproducible(stage)))
    if not stages:
        raise InputError(path, "expected a recording with a node's inputs and outputs")
    for stage in stages:
        if not counts.get(stage.takes[0]):
            raise InputError(path, f'expected {stage.takes[0]} as input of the {stage.node}')
    taken = {name for stage in stages for name in stage.takes if counts.get(name)}
    played = tuple(by_role[name] for name in sorted(taken))
    for topic in played:
        kind = next(kind for name, (kind, _) in TOPICS.items() if is_topic(topic, name))
        if source.topics[topic].type != type_name(kind):
            raise InputError(path, f'expected a {kind.__name__} on {topic}, found another type')
    first = stages[0].takes[0]
    return ReplayPlan(stages, played, by_role[first].removesuffix(f'/{first}'))


def recorded_parameters(recording: Recording, nodes: Collection[str], folder: Path,
                        policy: Path | None = None) -> dict[str, dict[str, Any]]:
    """Return the parameters of nodes, as kept in a recording.

    Files that parameters name are written to `folder` if the recording contains them, and the
    names are changed.

    Parameters
    ----------
    recording : Recording
        The recording.
    nodes : collection of str
        Names of the nodes.
    folder : Path
        Folder for files.
    policy : Path or None
        Network in place of the recorded one, which is not executed; None for none.

    Returns
    -------
    dict[str, dict of str to object]
        Parameters by node and name.

    Raises
    ------
    InputError
        If a policy drove and `policy` is None.
    """
    kept = recording.attachments()
    found: dict[str, dict[str, Any]] = {}
    for node in nodes:
        values = kept_parameters(recording.path, kept, node)
        values = {name: kept_file(kept, folder, name, value) for name, value in values.items()}
        if values.get(EXECUTED_FILE):
            values[EXECUTED_FILE] = str(policy.resolve()) if policy else ''
            if not policy and values.get('controller') == 'policy':
                raise InputError(recording.path, 'the controller was a policy: give its '
                                                 'network by --policy FILE; a network named '
                                                 'in a recording is not executed')
        found[node] = values
    return found


def kept_file(kept: Mapping[str, bytes], folder: Path, name: str, value: Any) -> Any:
    """Return the value of a parameter, with a file that the recording contains copied to a folder.

    Parameters
    ----------
    kept : mapping of str to bytes
        Attachments of the recording by name.
    folder : Path
        Folder for the copy.
    name : str
        Name of the parameter.
    value : object
        Its value.

    Returns
    -------
    object
        Path of the copy, or the value if it names no attachment.
    """
    if not name.endswith('_file') or value not in kept:
        return value
    copy = folder / f'{hashlib.sha256(kept[value]).hexdigest()[:16]}{Path(value).suffix}'
    copy.write_bytes(kept[value])
    return str(copy)


class _Outlet:
    """Stand-in for a publisher in a replay."""

    def __init__(self, publish: Callable[[Any], None]) -> None:
        self.publish = publish

    def get_subscription_count(self) -> int:
        return 0


class Replayed(Core):
    """Host of a core in a replay, mixed into the core.

    Parameters
    ----------
    stage : Stage
        The node.
    parameters : mapping of str to object
        Its parameters by full names.
    said : callable
        Function that is called with topic and message of each publication.
    """

    def __init__(self, stage: Stage, parameters: Mapping[str, Any],
                 said: Callable[[str, Any], None]) -> None:
        self._stage, self._said = stage, said
        self._values = dict(parameters)
        self._network = self._values.get(EXECUTED_FILE, '')
        self._calls: Iterator[str] = iter('')
        self.inlets: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self.withheld = ''
        """Why a parameter was not set as in the recording; '' if all were."""
        self._sets = {'': self._set(self.Parameters)}
        if isinstance(self, ControllerCore):
            def values(name: str, kind: type) -> Any:
                self._sets[f'{name}.'] = self._set(kind, f'{name}.')
                return self._sets[f'{name}.']
            self.make_stage(values, lambda patience: RepeatingWorker(
                patience, lambda: next(self._calls, IN_TIME)))
        self.connect()

    def _set(self, kind: type, prefix: str = '') -> Any:
        """Return parameters of a class; raise InputError for a value out of range."""
        try:
            return kind(**{name: settings.convert(kind, name, self._values.get(
                prefix + name, default)) for name, default in settings.defaults(kind).items()})
        except ValueError as error:
            raise InputError(self._stage.node, str(error)) from None

    @property
    def settings(self) -> Any:
        return self._sets['']

    def publisher(self, kind: type, topic: str, qos: QoSProfile = RELIABLE) -> Publisher:
        return cast(Publisher, _Outlet(lambda message: self._said(topic, message)))

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile = RELIABLE, raw: bool = False,
                  on_matched: Callable[[Any], None] | None = None) -> None:
        self.inlets[topic] = kind, callback

    def be_given(self, entry: Entry, data: bytes | None = None) -> None:
        """Process an entry of the log.

        Parameters
        ----------
        entry : Entry
            The entry.
        data : bytes or None
            The serialised message, if the entry is one.
        """
        self.now_ns, self._calls = entry.at_ns, iter(entry.calls)
        if entry.name == PARAMETERS:
            self._change(entry.what)
        elif entry.name in (EXPIRE, LET_GO):
            if isinstance(self, ControllerCore):
                (self.expire if entry.name == EXPIRE else self.let_go)()
        else:
            kind, callback = self.inlets[entry.name]
            message = kind(data=entry.what) if data is None else deserialize_message(data, kind)
            with contextlib.suppress(MessageError):  # the live node refused it as well
                callback(message)

    def _change(self, values: Mapping[str, Any]) -> None:
        values = dict(values)
        if values.get(EXECUTED_FILE, self._network) != self._network:
            self.withheld = (f'{EXECUTED_FILE} was set to another network; a replay does not '
                             'execute it')
            del values[EXECUTED_FILE]
        self._values |= values
        new = {prefix: self._set(type(old), prefix) for prefix, old in self._sets.items()}
        changed = {prefix: one for prefix, one in new.items() if one != self._sets[prefix]}
        if not self.take(changed, set(values)):
            self._sets = new


class Player:
    """One node in a replay: its core, and the log of its inputs.

    Parameters
    ----------
    stage : Stage
        The node.
    namespace : str
        Namespace of its recorded topics.
    parameters : mapping of str to object
        Its parameters by full names.
    source : Source
        Recording that is replayed.
    writer : RecordingWriter
        Recording that its answers are written to.
    kept_file : callable
        Function that returns, for name and value of a parameter, the value to use in the replay.
    """

    def __init__(self, stage: Stage, namespace: str, parameters: Mapping[str, Any],
                 source: Source, writer: RecordingWriter,
                 kept_file: Callable[[str, Any], Any]) -> None:
        self.doubt: Doubt | None = None
        """The frame from which the answers cannot be judged; None if all can."""
        self.played: set[int] = set()
        """Stamps [ns] of the frames that the core processed."""
        log = f'{namespace}/{LOG}'
        self.ordered = stage.node == 'coil_driver' or log in source.topics
        """Whether the order of the node's inputs is recorded."""
        self._stage, self._namespace = stage, namespace
        self._writer, self._kept_file = writer, kept_file
        core = type(f'Replayed{stage.core.__name__}', (Replayed, stage.core), {})
        self._core: Replayed = core(stage, parameters, self._keep)
        topics = {name: topic for name in stage.takes if name in self._core.inlets
                  for topic in source.topics if is_topic(topic, name)}
        self._inputs = Inputs(source, topics)
        if stage.node == 'coil_driver':
            self._log = self._commands(source)
        elif self.ordered:
            self._log = read_log(source, log, stage.node, stage.takes[0])
        else:
            self._log = order_of_receipt(source, {topic: name for name, topic in topics.items()})
        self._now_ns, self._reason = 0, ''

    def _commands(self, source: Source) -> Iterator[Entry]:
        """Yield the commands that a coil driver drove; it refuses late ones, and keeps no log."""
        answer = f'{self._namespace}/{self._stage.gives[0]}'
        topic = answer if answer in source.topics else f'{self._namespace}/field/command'
        for message in source.messages([topic]):
            yield Entry('field/command', header_stamp_ns(message.data), message.t_ns)

    def run(self, end_ns: int) -> None:
        """Play the log.

        Parameters
        ----------
        end_ns : int
            Time [ns] at which to end.
        """
        for entry in self._log:
            if entry.at_ns > end_ns:
                break
            self._now_ns = entry.at_ns
            self._take(entry)
            self._reason = self._reason or entry.doubt or self._core.withheld
            if entry.name == self._stage.takes[0]:
                self.played.add(entry.what)
                reason = self._reason or self._core.unrepeatable
                if reason and self.doubt is None:
                    self.doubt = Doubt(entry.what, reason)

    def _take(self, entry: Entry) -> None:
        node, data = self._stage.node, None
        if entry.name == PARAMETERS:
            if entry.what is None:
                self._reason = f'the {node} refused parameters'
                return
            entry = entry._replace(what={
                name: self._kept_file(name, value) for name, value in entry.what.items()})
        if entry.name in self._core.inlets and type(entry.what) is int:
            data = self._inputs.find(entry.name, entry.what, entry.at_ns)
            if data is None and node == 'coil_driver':
                entry = entry._replace(name='field/rotating')
                data = self._inputs.find(entry.name, entry.what, entry.at_ns)
            if data is None:
                self._reason = f'what the {node} received on {entry.name} was not recorded'
                return
        elif entry.name not in (PARAMETERS, EXPIRE, LET_GO, *self._core.inlets):
            if entry.name.startswith('~/'):
                self._reason = f'the {node} was taught on {entry.name[2:]} during the recording'
            return
        self._core.be_given(entry, data)

    def _keep(self, name: str, message: Any) -> None:
        if name in self._stage.gives:
            kind = type_name(type(message))
            self._writer.write(f'{self._namespace}/{name}', kind, self._now_ns,
                               whole(serialize_message(message), kind))


class Replay:
    """Replay of a recorded session through the present nodes, without graph, clock or deadline.

    Each node is given the inputs that it received when they were recorded. Inputs and answers are
    written to a new recording.

    Parameters
    ----------
    session : Path
        Recording.
    out : Path
        The new recording.
    plan : ReplayPlan
        Nodes and topics.
    parameters : Mapping[str, mapping of str to object]
        Parameters of each node by full names.
    end_s : float
        Time [s] at which to end; 0 for the end of the recording.

    Raises
    ------
    InputError
        If `end_s` is negative or not finite.
    """

    def __init__(self, session: Path, out: Path, plan: ReplayPlan,
                 parameters: Mapping[str, Mapping[str, Any]], end_s: float = 0.0) -> None:
        if not 0 <= end_s < math.inf:
            raise InputError('--end', f'expected a time of 0 s or later; received {end_s:g}')
        self.plan = plan
        self._session, self._out, self._end_s = session, out, end_s
        self._parameters = parameters
        self.players: dict[str, Player] = {}
        """Player of each node, by its name."""

    def run(self) -> None:
        """Play everything.

        Raises
        ------
        InputError
            If a node refuses its parameters.
        """
        with (open_source(self._session) as source, tempfile.TemporaryDirectory() as folder,
              RecordingWriter(self._out) as writer):
            kept = source.attachments() if isinstance(source, Recording) else {}
            end_ns = (source.start_ns + round(self._end_s * 1e9) if self._end_s
                      else source.end_ns + 1)
            for stage in self.plan.stages:
                player = self.players[stage.node] = Player(
                    stage, self.plan.namespace, self._parameters.get(stage.node, {}), source,
                    writer, partial(kept_file, kept, Path(folder)))
                player.run(end_ns)
            # The inputs of the nodes, so that `out` can be replayed again.
            taken = {*self.plan.played, f'{self.plan.namespace}/{LOG}'} & set(source.topics)
            given = {topic for topics in self.plan.answers.values() for topic in topics}
            for message in source.messages(taken - given, end_ns=end_ns):
                writer.write(*message)
            for name, content in kept.items():
                writer.attach(name, content)
