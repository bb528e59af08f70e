"""A session put once more through today's nodes, in lock-step. Imports no ROS: it starts it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from microbot_ros.errors import InputError
from microbot_ros.nodes.graph import PARENT, Graph
from microbot_ros.session.lockstep import FRAMES, frame_topic
from microbot_ros.session.playback import Source
from microbot_ros.session.recording import Recording
from microbot_ros.session.topics import is_topic


@dataclass(frozen=True)
class Stage:
    """What a node takes, the topic on which it answers each frame, what else it then says."""

    node: str
    takes: tuple[str, ...]
    answer: str
    also: tuple[str, ...] = ()


STAGES = (
    Stage('tracker', ('camera/image_raw', 'field/applied', 'field/command', 'field/rotation'),
          'particles', ('particles/poses',)),
    Stage('model', ('particles', 'field/applied', 'field/command', 'field/rotation'),
          'model/state'),
    Stage('controller', ('model/state', 'particles', 'goals',
                         'particle_goals', 'goal_pose', 'path', 'joy'),
          'field/command', ('field/rotation',)),
    Stage('coil_driver', ('field/command',), 'coils/command'),
)
"""The nodes whose answers follow from what is recorded, in the order of the graph."""

_READY_SECONDS = 30.0
_NO_DEADLINES = {'controller': {'deadline_ms': 1000.0}}
"""In lock-step the clock waits for whoever computes."""


@dataclass(frozen=True)
class Cast:
    """Which nodes are in play, and which recorded topics they are played."""

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


def cast(source: Source, path: Path, nodes: Collection[str] = ()) -> Cast:
    """The nodes to put in play: those named, or all whose input and answer were recorded.

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
    return Cast(stages, played, frame.removesuffix(f'/{role}'))


def recorded_parameters(recording: Recording, nodes: Collection[str], folder: Path,
                        ) -> dict[str, dict[str, Any]]:
    """Node → the parameters it had, as kept inside the recording.

    Files that parameters name are put into `folder` where they were kept too, and the names
    changed.
    """
    kept = recording.attachments()
    found: dict[str, dict[str, Any]] = {}
    for node in nodes:
        text = kept.get(f'parameters/{node}.yaml', b'{}')
        values = (yaml.safe_load(text) or {}).get(node, {}).get('ros__parameters', {})
        for name, value in values.items():
            if name.endswith('_file') and value in kept:
                values[name] = str(folder / f'{node}.{name}{Path(value).suffix}')
                Path(values[name]).write_bytes(kept[value])
        # ROS has no way to write an empty list into a parameter file.
        found[node] = {name: value for name, value in values.items() if value != []}
    return found


def rerun(session: Path, out: Path, players: Cast, parameters: dict[str, dict[str, Any]],
          end_s: float = 0.0) -> str:
    """Play `session` to the nodes in lock-step, and record that to `out`.

    Up to `end_s`, or to the end if that is 0. All nodes share a process that nobody else on the
    network sees or is seen by; a coil driver drives an emulated amplifier. Returns why the
    replay was given up, or ''. InputError where a node does not take its parameters, or the
    player the recording.
    """
    nodes = {node: {**parameters.get(node, {}), **_NO_DEADLINES.get(node, {})}
             for node in players.nodes}
    heard = [topic.removeprefix(f'{players.namespace}/')
             for topic in (*players.played, *players.outputs)]
    nodes['recorder'] = {'folder': str(out), 'topics': [*heard, '/parameter_events']}
    nodes['player'] = {
        'session': str(session), 'rate': 0.0, 'end_s': end_s, 'topics': list(players.played),
        'answers': [stage.answer for stage in players.stages]}
    with tempfile.TemporaryDirectory() as name, Graph(lambda *_: None) as graph:
        file, port = Path(name) / 'parameters.yaml', Path(name) / 'amplifier'
        if 'coil_driver' in nodes:
            nodes['coil_driver'] |= {'amplifier': 'serial_transfer', 'port': str(port)}
            graph.start('amplifier', [sys.executable, '-m', 'microbot_ros.cli', 'emulate',
                                      'serial_transfer', '--link', str(port)], 'serving')
            graph.wait_ready(_READY_SECONDS)
        file.write_text(yaml.safe_dump({
            f'/**/{node}': {'ros__parameters': {**values, 'use_sim_time': True}}
            for node, values in nodes.items()}))
        done = subprocess.run(
            [sys.executable, '-m', 'microbot_ros.nodes', *nodes, '--ros-args', '--params-file',
             str(file), '-r', f'__ns:={players.namespace or "/"}',
             # What is read back from the emulator is not what moved the particles.
             '-r', 'coil_driver:field/applied:=coil_driver/field/applied'],
            env={**os.environ, PARENT: str(os.getpid()), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'},
            stdin=subprocess.DEVNULL, capture_output=True, text=True)
    said = done.stderr.strip().splitlines() or [f'ended with status {done.returncode}']
    reason = said[-1].removeprefix('microbot: ')
    if done.returncode == 2:
        raise InputError(session, reason)
    return reason if done.returncode else ''
