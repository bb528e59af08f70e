"""A recording once more through today's nodes, in the order in which they took it in."""

from __future__ import annotations

import contextlib
import hashlib
import math
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from microbot_ros.common import settings, strict_yaml
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
from microbot_ros.session.mcap.recording import Recording, is_topic
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

_REMEMBERED = 5000
"""Answers of a node that are kept for the node that takes them: 50 s at 100 Hz."""


class CoilCore(Core):
    """`field/command`, `field/rotating` → `coils/command`, without gate and amplifier."""

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

    `takes` lists its topics, the one that it answers first; `answer` is the topic of its answer
    and `also` what it publishes beside it; `core` is what it runs.
    """

    node: str
    takes: tuple[str, ...]
    answer: str
    also: tuple[str, ...]
    core: type[Core]

    @property
    def gives(self) -> tuple[str, ...]:
        """All topics that it publishes."""
        return (self.answer, *self.also)


STAGES = (
    Stage('tracker', ('camera/image_raw', 'field/applied', 'field/command', 'field/rotating'),
          'particles', ('particles/poses',), TrackerCore),
    Stage('model', ('particles', 'field/applied', 'field/command', 'field/rotating'),
          'model/state', (), ModelCore),
    Stage('controller', ('model/state', 'goals', 'particle_goals', 'goal_pose', 'path',
                         'field/plan', 'joy'), 'field/command', ('field/rotating',),
          ControllerCore),
    Stage('coil_driver', ('field/command', 'field/rotating'), 'coils/command', (), CoilCore),
)
"""The nodes whose answers follow from what is recorded, in the order of the graph.

What a node takes from one before it is what that one answers in the replay; what comes back from
one after it, the field, is what was recorded."""


@dataclass(frozen=True)
class ReplayPlan:
    """Which nodes are replayed, in which `namespace`, and the recorded topics `played` to them."""

    stages: tuple[Stage, ...]
    played: tuple[str, ...]
    namespace: str

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes, in order."""
        return tuple(stage.node for stage in self.stages)

    @property
    def answers(self) -> dict[str, tuple[str, ...]]:
        """Node → the topics that it publishes, as they are recorded."""
        return {stage.node: tuple(f'{self.namespace}/{topic}' for topic in stage.gives)
                for stage in self.stages}


def plan_replay(source: Source, path: Path, nodes: Collection[str] = ()) -> ReplayPlan:
    """Return the plan for a `source` at `path`, with the `nodes` named, or all that were recorded.

    A tracker that took more frames than were recorded cannot give the same answers, and is not
    replayed unless it is named. Raises InputError where there is nothing to replay.
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
        raise InputError(path, 'expected a recording of what a node took and what it answered')
    given = set[str]()
    taken = set[str]()
    for stage in stages:
        if stage.takes[0] not in given and not counts.get(stage.takes[0]):
            raise InputError(path, f'expected {stage.takes[0]} to play to the {stage.node}')
        taken |= {topic for topic in stage.takes if topic not in given}
        given |= set(stage.gives)
    played = tuple(by_role[name] for name in sorted(taken) if counts.get(name))
    for topic in played:
        kind = next(kind for name, (kind, _) in TOPICS.items() if is_topic(topic, name))
        if source.topics[topic].type != type_name(kind):
            raise InputError(path, f'expected a {kind.__name__} on {topic}, found another type')
    first = stages[0].takes[0]
    return ReplayPlan(stages, played, by_role[first].removesuffix(f'/{first}'))


def recorded_parameters(recording: Recording, nodes: Collection[str], folder: Path,
                        policy: Path | None = None) -> dict[str, dict[str, Any]]:
    """Return the parameters of each of the `nodes`, as kept inside the recording.

    Files that parameters name are put into `folder` where they were kept too, and the names
    changed. `policy` takes the place of the network that the recording names, which is not
    executed; InputError where a policy drove and None is given.
    """
    kept = recording.attachments()
    found: dict[str, dict[str, Any]] = {}
    for node in nodes:
        values = _kept_parameters(recording, kept.get(f'parameters/{node}.yaml', b''), node)
        values = {name: kept_file(kept, folder, name, value) for name, value in values.items()}
        if values.get(EXECUTED_FILE):
            values[EXECUTED_FILE] = str(policy.resolve()) if policy else ''
            if not policy and values.get('controller') == 'policy':
                raise InputError(recording.path, 'a policy drove: expected its network by '
                                 '--policy FILE; one that a recording names is not executed')
        found[node] = values
    return found


def kept_file(kept: Mapping[str, bytes], folder: Path, name: str, value: Any) -> Any:
    """Return the `value` of a parameter `name`; where it names a file that was `kept`, a copy in
    `folder`.
    """
    if not name.endswith('_file') or value not in kept:
        return value
    copy = folder / f'{hashlib.sha256(kept[value]).hexdigest()[:16]}{Path(value).suffix}'
    copy.write_bytes(kept[value])
    return str(copy)


def _kept_parameters(recording: Recording, text: bytes, node: str) -> dict[str, Any]:
    """Return the parameters of a `node` in the `text` of a file kept inside a recording."""
    try:
        content = strict_yaml.load(text.decode())[1] or {}
        values: dict[str, Any] = dict(content.get(node, {}).get('ros__parameters', {}))
    except (strict_yaml.YamlError, ValueError, TypeError, AttributeError):
        raise InputError(recording.path, f'expected the parameters of {node} in it') from None
    if not all(isinstance(name, str) and Path(name).name == name for name in values):
        raise InputError(recording.path, f'expected names of parameters of {node} in it')
    return values


class _Outlet:
    """What a core takes for a publisher."""

    def __init__(self, publish: Callable[[Any], None]) -> None:
        self.publish = publish

    def get_subscription_count(self) -> int:
        return 0


class Replayed(Core):
    """Mixed into a core: the host of a `stage` in a replay, with `parameters` by full names.

    `said(topic, message)` is called with what the core publishes.
    """

    def __init__(self, stage: Stage, parameters: Mapping[str, Any],
                 said: Callable[[str, Any], None]) -> None:
        self._stage, self._said = stage, said
        self._values = dict(parameters)
        self._network = self._values.get(EXECUTED_FILE, '')
        self._calls: Iterator[str] = iter('')
        self.inlets: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self.withheld = ''
        """Why a parameter was not set as it was when it was recorded; '' where all were."""
        self._sets = {'': self._set(self.Parameters)}
        if isinstance(self, ControllerCore):
            def values(name: str, kind: type) -> Any:
                self._sets[f'{name}.'] = self._set(kind, f'{name}.')
                return self._sets[f'{name}.']
            self.make_stage(values, lambda patience: RepeatingWorker(
                patience, lambda: next(self._calls, IN_TIME)))
        self.connect()

    def _set(self, kind: type, prefix: str = '') -> Any:
        """Return an instance of a `kind` of parameters; InputError for a value out of range."""
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
        """Take an `entry` of the log in, where it is a message with its `data`."""
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
            self.withheld = (f'{EXECUTED_FILE} was set to another network, which a replay does '
                             'not execute')
            del values[EXECUTED_FILE]
        self._values |= values
        new = {prefix: self._set(type(old), prefix) for prefix, old in self._sets.items()}
        changed = {prefix: one for prefix, one in new.items() if one != self._sets[prefix]}
        if not self.take(changed, set(values)):
            self._sets = new


class _Player:
    """Plays the log of one node to its core: `step` by step, an entry each.

    `before` are the players whose answers it takes.
    """

    def __init__(self, stage: Stage, replay: Replay, parameters: Mapping[str, Any],
                 source: Source, before: list[_Player]) -> None:
        self.stage = stage
        self.doubt: Doubt | None = None
        """From which frame on the answers cannot be judged; None where all can."""
        self.played: set[int] = set()
        """Stamps [ns] of the frames that the core took."""
        self._said: dict[tuple[str, int], bytes] = {}
        self._replay, self._before = replay, before
        core = type(f'Replayed{stage.core.__name__}', (Replayed, stage.core), {})
        self._core: Replayed = core(stage, parameters, self._keep)
        given = {name for player in before for name in player.stage.gives}
        topics = {name: topic for name in stage.takes if name in self._core.inlets
                  and name not in given for topic in source.topics if is_topic(topic, name)}
        self._inputs = Inputs(source, topics)
        self.ordered = stage.node == 'coil_driver'
        """Whether the order in which the node took things in is recorded."""
        self._log = self._find_log(source)
        self._now_ns, self._reason = 0, ''

    def _find_log(self, source: Source) -> Iterator[Entry]:
        stage, namespace = self.stage, self._replay.plan.namespace
        if self.ordered:
            return self._commands(source, f'{namespace}/{stage.answer}')
        log = f'{namespace}/{LOG}'
        if log in source.topics:
            self.ordered = True
            return read_log(source, log, stage.node, stage.takes[0])
        frames = f'{namespace}/{stage.takes[0]}'
        topics = {f'{namespace}/{name}': name for name in self._core.inlets}
        return order_of_receipt(source, {
            topic: name for topic, name in topics.items()
            if topic in source.topics or topic == frames})

    def _commands(self, source: Source, answer: str) -> Iterator[Entry]:
        """Return the commands that a coil driver took; it refuses late ones, and keeps nothing."""
        topic = answer if answer in source.topics else (
            f'{self._replay.plan.namespace}/field/command')
        for message in source.messages([topic]):
            yield Entry('field/command', header_stamp_ns(message.data), message.t_ns)

    def step(self) -> bool:
        """Play the next entry; return False where there is none before the end of the replay."""
        entry = next(self._log, None)
        if entry is None or entry.at_ns > self._replay.end_ns:
            return False
        self._now_ns = entry.at_ns
        self._take(entry)
        self._reason = self._reason or entry.doubt or self._core.withheld
        if entry.name == self.stage.takes[0]:
            self.played.add(entry.what)
            reason = self._reason or self._core.unrepeatable
            if reason and self.doubt is None:
                self.doubt = Doubt(entry.what, reason)
        for forgotten in [*self._said][:max(0, len(self._said) - _REMEMBERED)]:
            del self._said[forgotten]
        return True

    def _take(self, entry: Entry) -> None:
        data = None
        if entry.name == PARAMETERS:
            if entry.what is None:
                self._reason = f'the {self.stage.node} refused parameters'
                return
            entry = entry._replace(what={
                name: kept_file(self._replay.kept, self._replay.folder, name, value)
                for name, value in entry.what.items()})
        if entry.name in self._core.inlets and type(entry.what) is int:
            data = self._find(entry)
            if data is None and self.stage.node == 'coil_driver':
                entry = entry._replace(name='field/rotating')
                data = self._find(entry)
            if data is None:
                self._reason = (f'what the {self.stage.node} took from {entry.name} was not '
                                'recorded')
                return
        elif entry.name not in (PARAMETERS, EXPIRE, LET_GO, *self._core.inlets):
            if entry.name.startswith('~/'):
                self._reason = f'the {self.stage.node} was taught by {entry.name[2:]}'
            return
        self._core.be_given(entry, data)

    def _find(self, entry: Entry) -> bytes | None:
        for player in self._before:
            if entry.name in player.stage.gives:
                return player.answer(entry)
        return self._inputs.find(entry.name, entry.what, entry.at_ns)

    def answer(self, entry: Entry) -> bytes | None:
        """Return what the core answers to the frame that an `entry` of another node names."""
        while (entry.name, entry.what) not in self._said and entry.what not in self.played and (
                self._now_ns <= entry.at_ns and self.step()):
            pass
        return self._said.get((entry.name, entry.what))

    def _keep(self, name: str, message: Any) -> None:
        if name in self.stage.gives:
            kind = type_name(type(message))
            data = whole(serialize_message(message), kind)
            self._said[name, header_stamp_ns(data)] = data
            self._replay.writer.write(
                f'{self._replay.plan.namespace}/{name}', kind, self._now_ns, data)


class Replay:
    """A recorded `session` through today's nodes, without a graph, a clock or a deadline.

    By a `plan`, with `parameters` of each node, up to `end_s` [s] or the end if that is 0. What
    the nodes take and what they answer is written to `out`, a recording.
    """

    writer: RecordingWriter
    end_ns: int
    kept: Mapping[str, bytes]
    """Files kept inside the recording."""
    folder: Path
    """Where copies of those that parameters name are put."""

    def __init__(self, session: Path, out: Path, plan: ReplayPlan,
                 parameters: Mapping[str, Mapping[str, Any]], end_s: float = 0.0) -> None:
        if not 0 <= end_s < math.inf:
            raise InputError(session, f'end_s must be finite; received {end_s:g}')
        self.plan = plan
        self._session, self._out, self._end_s = session, out, end_s
        self._parameters = parameters
        self.players: dict[str, _Player] = {}
        """The node's name → what played it."""

    def run(self) -> None:
        """Play all of it. Raises InputError where a node refuses its parameters."""
        with contextlib.ExitStack() as leaving:
            source = leaving.enter_context(open_source(self._session))
            self.kept = source.attachments() if isinstance(source, Recording) else {}
            self.folder = Path(leaving.enter_context(tempfile.TemporaryDirectory()))
            self.writer = leaving.enter_context(RecordingWriter(self._out))
            self.end_ns = (source.start_ns + round(self._end_s * 1e9) if self._end_s
                           else source.end_ns + 1)
            before: list[_Player] = []
            for stage in self.plan.stages:
                player = _Player(stage, self, self._parameters.get(stage.node, {}), source, before)
                self.players[stage.node] = player
                before = [*before, player]
            for player in reversed(before):
                while player.step():
                    pass
            self._copy(source)

    def _copy(self, source: Source) -> None:
        """Write what the nodes took, so that `out` is a recording to replay again."""
        taken = {*self.plan.played, f'{self.plan.namespace}/{LOG}'} & set(source.topics)
        given = {topic for topics in self.plan.answers.values() for topic in topics}
        for message in source.messages(taken - given, end_ns=self.end_ns):
            self.writer.write(*message)
        for name, content in self.kept.items():
            self.writer.attach(name, content)
