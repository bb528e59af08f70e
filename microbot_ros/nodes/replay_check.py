"""A session put once more through today's nodes, each in the order in which it took things."""

from __future__ import annotations

import contextlib
import math
import sys
import tempfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from microbot_ros.common import strict_yaml
from microbot_ros.common.errors import InputError
from microbot_ros.control.plugins.policy import EXECUTED_FILE
from microbot_ros.nodes.graph import Graph
from microbot_ros.nodes.offline import alone, end_offline, make_offline
from microbot_ros.nodes.recorder import keep_parameters
from microbot_ros.nodes.replayed_node import ReplayedNode, SilentError, Stage
from microbot_ros.nodes.topics import CHANGES, TOPICS, type_name
from microbot_ros.session.accounts import Doubt
from microbot_ros.session.lockstep import FRAMES, frame_topic
from microbot_ros.session.playback import Source, open_source
from microbot_ros.session.recorder import RecordingWriter
from microbot_ros.session.recording import Recording, is_topic

STAGES = (
    Stage('tracker', ('camera/image_raw', 'field/applied', 'field/command', 'field/rotation'),
          'particles', ('particles/poses',)),
    Stage('model', ('particles', 'field/applied', 'field/command', 'field/rotation'),
          'model/state'),
    Stage('controller', ('model/state', 'goals', 'particle_goals', 'goal_pose', 'path',
                         'field/plan', 'joy'), 'field/command', ('field/rotation',)),
    Stage('coil_driver', ('field/command',), 'coils/command'),
)
"""The nodes whose answers follow from what is recorded, in the order of the graph."""

_READY_SECONDS = 30.0


@dataclass(frozen=True)
class ReplayPlan:
    """Which nodes are in play, in which `namespace`, and which recorded topics are played."""

    stages: tuple[Stage, ...]
    played: tuple[str, ...]
    namespace: str

    @property
    def nodes(self) -> tuple[str, ...]:
        """Their names, in order."""
        return tuple(stage.node for stage in self.stages)

    @property
    def answers(self) -> dict[str, tuple[str, ...]]:
        """The topic on which each of them answers: that and all else that it gives, as they are
        recorded."""
        return {f'{self.namespace}/{stage.answer}': tuple(
            f'{self.namespace}/{topic}' for topic in (stage.answer, *stage.also))
            for stage in self.stages}

    @property
    def outputs(self) -> tuple[str, ...]:
        """All topics that they give, as they are recorded."""
        return tuple(topic for topics in self.answers.values() for topic in topics)

    @property
    def frame(self) -> str:
        """The topic that sets them going, as it is recorded."""
        return frame_topic(self.played)


def plan_replay(source: Source, path: Path, nodes: Collection[str] = ()) -> ReplayPlan:
    """The nodes to put in play from a `source` at `path`: those named, or all that were recorded.

    A tracker that was shown more frames than were kept cannot give the same answers, and is not
    put in play unless it is named. InputError where there is nothing to play.
    """
    by_role = {name: topic for topic in source.topics for stage in STAGES
               for name in (*stage.takes, stage.answer) if is_topic(topic, name)}
    counts = {name: source.topics[topic].count for name, topic in by_role.items()}

    def reproducible(stage: Stage) -> bool:
        enough = stage.node != 'tracker' or counts.get('camera/image_raw', 0) >= counts.get(
            'particles', 0)
        return bool(counts.get(stage.takes[0]) and counts.get(stage.answer) and enough)

    stages = tuple(stage for stage in STAGES
                   if (stage.node in nodes if nodes else reproducible(stage)))
    made = {topic for stage in stages for topic in (stage.answer, *stage.also)}
    wanted = {topic for stage in stages for topic in stage.takes} - made
    played = tuple(by_role[name] for name in sorted(wanted) if counts.get(name))
    for stage in stages:
        if stage.takes[0] not in made and not counts.get(stage.takes[0]):
            raise InputError(path, f'expected {stage.takes[0]} to play to the {stage.node}')
    frame = frame_topic(played)
    if not frame:
        raise InputError(path, 'expected a recording of what a node took and what it answered')
    role = next(name for name in FRAMES if is_topic(frame, name))
    return ReplayPlan(stages, played, frame.removesuffix(f'/{role}'))


def recorded_parameters(recording: Recording, nodes: Collection[str], folder: Path,
                        policy: Path | None = None) -> dict[str, dict[str, Any]]:
    """Node, of `nodes`, → the parameters it had, as kept inside the recording.

    Files that parameters name are put into `folder` where they were kept too, and the names
    changed. `policy` takes the place of the network that the recording names, which is not
    executed; InputError where a policy drove and None is given.
    """
    kept = recording.attachments()
    found: dict[str, dict[str, Any]] = {}
    for node in nodes:
        values = _kept_parameters(recording, kept.get(f'parameters/{node}.yaml', b''), node)
        for name, value in values.items():
            if name.endswith('_file') and value in kept:
                values[name] = str(folder / f'{node}.{name}{Path(value).suffix}')
                Path(values[name]).write_bytes(kept[value])
        if values.get(EXECUTED_FILE):
            values[EXECUTED_FILE] = str(policy.resolve()) if policy else ''
            if not policy and values.get('controller') == 'policy':
                raise InputError(recording.path, 'a policy drove: expected its network by '
                                 '--policy FILE; one that a recording names is not executed')
        # ROS has no way to write an empty list into a parameter file.
        found[node] = {name: value for name, value in values.items() if value != []}
    return found


def _kept_parameters(recording: Recording, text: bytes, node: str) -> dict[str, Any]:
    """The parameters of a `node` in the `text` of a file kept inside a recording."""
    try:
        content = strict_yaml.load(text.decode())[1] or {}
        values: dict[str, Any] = dict(content.get(node, {}).get('ros__parameters', {}))
    except (strict_yaml.YamlError, ValueError, TypeError, AttributeError):
        raise InputError(recording.path, f'expected the parameters of {node} in it') from None
    if not all(isinstance(name, str) and Path(name).name == name for name in values):
        raise InputError(recording.path, f'expected names of parameters of {node} in it')
    return values


class ReplayCheck:
    """Recorded inputs once more through today's nodes, in the order in which each node took them:
    a loop over frames, without a graph, a clock or a deadline.

    What is played of `session`, by a `plan` and with `parameters`, up to `end_s` or the end if
    that is 0, and what the nodes say to it is written to `out`, a recording. A coil driver drives
    an emulated amplifier.
    """

    def __init__(self, session: Path, out: Path, plan: ReplayPlan,
                 parameters: dict[str, dict[str, Any]], end_s: float = 0.0) -> None:
        if not 0 <= end_s < math.inf:
            raise InputError(session, f'end_s must be finite; received {end_s:g}')
        self._session, self._out, self._plan, self._end_s = session, out, plan, end_s
        self._parameters = parameters
        self.played: dict[str, set[int]] = {}
        """By answer: the stamps [ns] of the frames that were played."""
        self.doubts: dict[str, list[Doubt]] = {}
        """By answer: frames that can't be judged."""

    def run(self) -> str:
        """Play it all. Why it was given up, or ''; InputError where a node refuses to begin."""
        with contextlib.ExitStack() as leaving:
            source = leaving.enter_context(open_source(self._session))
            self._check_types(source)
            folder = Path(leaving.enter_context(tempfile.TemporaryDirectory()))
            parameters = self._with_amplifier(folder, leaving)
            leaving.enter_context(alone(self._plan.namespace, parameters, folder))
            writer = leaving.enter_context(RecordingWriter(self._out))
            end_ns = source.start_ns + round(self._end_s * 1e9) if self._end_s else source.end_ns
            parts = self._parts(source, writer, end_ns, leaving)
            inputs = source.messages(
                {*self._plan.played, CHANGES} & set(source.topics), end_ns=end_ns + 1)
            try:
                while moving := [part for part in parts if not part.over]:
                    # Two that wait for each other can't be, but for what is not recorded.
                    part = next((part for part in moving if part.ready(parts)), moving[0])
                    while part is parts[0] and (kept := next(inputs, None)) is not None:
                        writer.write(*kept)
                        if kept.t_ns >= part.now_ns:
                            break
                    part.step(parts)
                for kept in inputs:
                    writer.write(*kept)
            except SilentError as error:
                return str(error)
            self.played = {part.answer: part.played for part in parts}
            self.doubts = {part.answer: part.doubts for part in parts}
        return ''

    def _check_types(self, source: Source) -> None:
        for topic in self._plan.played:
            kind = next(kind for name, (kind, _) in TOPICS.items() if is_topic(topic, name))
            if source.topics[topic].type != type_name(kind):
                raise InputError(self._session, f'expected a {kind.__name__} on {topic}, found '
                                                'another type')

    def _with_amplifier(self, folder: Path, leaving: contextlib.ExitStack,
                        ) -> dict[str, dict[str, Any]]:
        """The parameters of each node; those of a coil driver lead to an emulated amplifier."""
        found = {node: dict(self._parameters.get(node, {})) for node in self._plan.nodes}
        if 'coil_driver' in found:
            port = folder / 'amplifier'
            found['coil_driver'] |= {'amplifier': 'serial_transfer', 'port': str(port)}
            graph = leaving.enter_context(Graph(lambda *_: None))
            graph.start('amplifier', [sys.executable, '-m', 'microbot_ros.cli', 'emulate',
                                      'serial_transfer', '--link', str(port)], 'serving')
            graph.wait_ready(_READY_SECONDS)
        return found

    def _parts(self, source: Source, writer: RecordingWriter, end_ns: int,
               leaving: contextlib.ExitStack) -> list[ReplayedNode]:
        names, kept = (self._plan.namespace, self._plan.frame), set[str]()
        parts: list[ReplayedNode] = []
        for stage in self._plan.stages:
            node = make_offline(stage.node)
            leaving.callback(end_offline, node)
            keep_parameters(writer, stage.node, node.values, kept)
            parts.append(ReplayedNode(node, stage, source, names, writer, end_ns))
        return parts
