"""Command `microbot replay --check`: compare answers of the present nodes with recorded ones."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from microbot_ros.common.errors import InputError
from microbot_ros.common.files import write_json
from microbot_ros.session.mcap.recording import Recording, is_recording
from microbot_ros.session.replay.compare import Doubt, TopicDifference, compare
from microbot_ros.session.replay.log import header_stamp_ns

if TYPE_CHECKING:
    from rich.table import Table

    from microbot_ros.nodes.replay import Replay


ORDER_TOLERANCE, ORDER_SHARE = 1e-3, 0.01
"""Criteria if the order of the nodes' inputs is not recorded: at least 99 % of the answers agree
to a thousandth of the largest value in their field. Choice: at 100 Hz, one frame a second differs
by a goal or field that was received a frame earlier or later. At half the share two such frames in
4 s count as a difference; at twice, a change of 2 % of the frames does not."""


def run_check(session: Path, nodes: Collection[str], end: float, tolerance: float,
              config: Path | None, policy: Path | None, out: Path | None,
              json_path: Path | None) -> int:
    """Replay a session, compare, and print the result.

    Parameters
    ----------
    session : Path
        A recording.
    nodes : collection of str
        Names of the nodes to replay; empty for all.
    end : float
        Time at which to end [s].
    tolerance : float
        Largest difference of numbers, as a share of the largest in their field.
    config : Path or None
        File with parameters in place of the recorded ones.
    policy : Path or None
        Network in place of the one that the recording names.
    out, json_path : Path or None
        Files for the answers and the differences.

    Returns
    -------
    int
        0 if every answer that can be judged is the same, else 1.
    """
    console = Console(highlight=False, width=None if Console().is_terminal else 150, markup=False)
    if session.exists() and not is_recording(session):
        raise InputError(session, 'expected a recording to check, found a folder of CSV files')
    with tempfile.TemporaryDirectory() as name:
        found = _replay(session, nodes, end, tolerance, config, policy,
                        out or Path(name) / 'replayed', Path(name))
    console.print(_table([topic for topic, _ in found]))
    for topic, doubt in found:
        if topic.unjudged and doubt:
            console.print(f'{topic.topic}: {topic.unjudged} frames cannot be compared: '
                          f'{doubt.reason}')
    same, verdict = _verdict([topic for topic, _ in found])
    console.print(f'{session}: {verdict}')
    write_json(json_path, {
        'same': same, 'topics': [_entry(topic, doubt) for topic, doubt in found]})
    return 0 if same else 1


def _verdict(found: list[TopicDifference]) -> tuple[bool, str]:
    """Return whether all answers agree, and a sentence; no comparable answer is a failure."""
    if not all(topic.same for topic in found):
        return False, 'answers differ'
    blind = [topic.topic for topic in found if topic.unjudged and not topic.pairs]
    if blind:
        return False, f'no output on {blind[0]} can be compared'
    doubtful = any(topic.unjudged for topic in found)
    return True, 'all outputs are equal' + (', as far as they can be compared' if doubtful else '')


def _replay(session: Path, nodes: Collection[str], end: float, tolerance: float,
            config: Path | None, policy: Path | None, out: Path, scratch: Path,
            ) -> list[tuple[TopicDifference, Doubt | None]]:
    """Replay, and return the difference of each topic with its doubts."""
    from microbot_ros.nodes.configuration import read_rig
    from microbot_ros.nodes.replay import Replay, plan_replay, recorded_parameters

    progress = Console(stderr=True, highlight=False, markup=False)
    with Recording(session) as recorded:
        plan = plan_replay(recorded, session, nodes)
        parameters = read_rig(config) if config else recorded_parameters(
            recorded, plan.nodes, scratch, policy)
        if lacking := [node for node in plan.nodes if not parameters.get(node)]:
            progress.print(f'{config or session}: no parameters of {", ".join(lacking)} in it: '
                           'defaults are used', soft_wrap=True)
        replay = Replay(session, out, plan, parameters, end)
        length = end or (recorded.end_ns - recorded.start_ns) / 1e9
        with progress.status(f'{length:.0f} s through {", ".join(plan.nodes)}'):
            replay.run()
        with Recording(out) as replayed:
            return _compared(recorded, replayed, replay, tolerance, progress)


def _compared(recorded: Recording, replayed: Recording, replay: Replay, tolerance: float,
              progress: Console) -> list[tuple[TopicDifference, Doubt | None]]:
    """Compare the answers of each node."""
    found: list[tuple[TopicDifference, Doubt | None]] = []
    for node, topics in replay.plan.answers.items():
        player = replay.players[node]
        allowed, doubt = tolerance, player.doubt
        if not player.ordered:
            allowed = max(tolerance, ORDER_TOLERANCE)
            doubt = doubt or Doubt(0, f'the order in which the {node} received '
                                      'its messages is not recorded', ORDER_SHARE)
        found += [(topic, doubt) for topic in compare(
            recorded, replayed, {*topics}.intersection([*recorded.topics, *replayed.topics]),
            _answered(recorded, topics, player.played, progress), allowed, doubt)]
    return found


def _answered(
    recorded: Recording, topics: tuple[str, ...], stamps: set[int], progress: Console,
) -> set[int]:
    """Return the frames that a node answered when it was recorded; all if it answered none.

    A node that was started later, was ended earlier, or took poses for too old skipped frames.
    """
    there = [topic for topic in topics if topic in recorded.topics]
    answered = stamps.intersection(
        header_stamp_ns(message.data) for message in recorded.messages(there)) or stamps
    if passed := len(stamps) - len(answered):
        progress.print(f'{topics[0]}: left out {passed} of {len(stamps)} frames that were not '
                       'answered in the recording', soft_wrap=True)
    return answered


def _table(found: list[TopicDifference]) -> Table:
    from rich.table import Table

    table = Table('topic', 'compared', 'differ', 'only recorded', 'only replayed',
                  'not judged', 'first difference', 'largest', box=None)
    for topic in found:
        first = topic.first
        where = '' if first is None else (
            f'{first.t_s:.3f} s, {first.field}: {first.a} → {first.b}')
        field, size = max(topic.largest.items(), key=lambda entry: entry[1], default=('', 0.0))
        largest = '' if not size else f'{field} by {size:.3g}'
        table.add_row(topic.topic, str(topic.pairs), str(topic.unequal), str(topic.only_a),
                      str(topic.only_b), str(topic.unjudged), where, largest)
    return table


def _entry(topic: TopicDifference, doubt: Doubt | None) -> dict[str, Any]:
    """Return a topic for JSON; differences that are not numbers have no size."""
    first = topic.first
    return {
        'topic': topic.topic, 'compared': topic.pairs, 'differ': topic.unequal,
        'only_recorded': topic.only_a, 'only_replayed': topic.only_b,
        'not_judged': {doubt.reason: topic.unjudged} if doubt and topic.unjudged else {},
        'first': None if first is None else {
            't_s': first.t_s, 'field': first.field, 'recorded': first.a, 'replayed': first.b},
        'largest': {field: size if math.isfinite(size) else None
                    for field, size in topic.largest.items()},
    }
