"""`microbot replay --check`: do today's nodes answer as they did when it was recorded?"""

from __future__ import annotations

import json
import math
import tempfile
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from microbot_ros.common.errors import InputError
from microbot_ros.common.files import write_text
from microbot_ros.session.accounts import Doubt
from microbot_ros.session.compare import TopicDifference, compare
from microbot_ros.session.lockstep import header_stamp_ns
from microbot_ros.session.recording import is_recording, open_recording

if TYPE_CHECKING:
    from rich.table import Table

    from microbot_ros.nodes.replay_check import ReplayCheck, ReplayPlan
    from microbot_ros.session.recording import Recording


def run_check(session: Path, nodes: Collection[str], end: float, tolerance: float,
              config: Path | None, policy: Path | None, out: Path | None,
              json_path: Path | None) -> int:
    """Replay a `session`, compare, tell: 0 where every answer that can be judged is the same, else
    1.

    By `nodes`, none for all, up to `end` [s], with parameters of `config`, those recorded where
    it is None, and the network `policy` in place of one that the recording names. Numbers may
    differ by `tolerance` of their size. What they say goes to `out`, differences to `json_path`,
    where given.
    """
    console = Console(highlight=False, width=None if Console().is_terminal else 150)
    if session.exists() and not is_recording(session):
        raise InputError(session, 'expected a recording to check, found a folder of CSV files')
    with tempfile.TemporaryDirectory() as name:
        found, failure = _replay(session, nodes, end, tolerance, config, policy,
                                 out or Path(name) / 'replayed', Path(name))
    if failure:
        Console(stderr=True, highlight=False).print(f'{session}: {failure}')
        return 1
    console.print(_table(found))
    for topic in found:
        for reason, count in Counter(topic.unjudged.values()).most_common():
            console.print(f'{topic.topic}: {count} frames cannot be judged: {reason}')
    same, verdict = _verdict(found)
    console.print(f'{session}: {verdict}')
    if json_path:
        entries = {'same': same, 'topics': [_entry(topic) for topic in found]}
        write_text(json_path, json.dumps(entries, indent=1, allow_nan=False) + '\n')
    return 0 if same else 1


def _verdict(found: list[TopicDifference]) -> tuple[bool, str]:
    """Whether all is well, and that in words. What can't be judged at all is not well."""
    if not all(topic.same for topic in found):
        return False, 'answers differ'
    blind = [topic.topic for topic in found if topic.unjudged and not topic.pairs]
    if blind:
        return False, f'no answer on {blind[0]} can be judged'
    doubtful = any(topic.unjudged for topic in found)
    return True, 'every answer is the same' + (', where it can be judged' if doubtful else '')


def _replay(session: Path, nodes: Collection[str], end: float, tolerance: float,
            config: Path | None, policy: Path | None, out: Path, scratch: Path,
            ) -> tuple[list[TopicDifference], str]:
    """The differences, and why the replay was given up, or ''."""
    from microbot_ros.nodes.configuration import read_rig
    from microbot_ros.nodes.replay_check import ReplayCheck, plan_replay, recorded_parameters

    progress = Console(stderr=True, highlight=False)
    with open_recording(session) as recorded:
        plan = plan_replay(recorded, session, nodes)
        parameters = read_rig(config) if config else recorded_parameters(
            recorded, plan.nodes, scratch, policy)
        run = ReplayCheck(session, out, plan, parameters, end)
        length = end or (recorded.end_ns - recorded.start_ns) / 1e9
        with progress.status(f'{length:.0f} s through {", ".join(plan.nodes)}'):
            if failure := run.run():
                return [], failure
        with open_recording(out) as replayed:
            return _compared(recorded, replayed, plan, run, tolerance, progress), ''


def _compared(recorded: Recording, replayed: Recording, plan: ReplayPlan, run: ReplayCheck,
              tolerance: float, progress: Console) -> list[TopicDifference]:
    """Node after node, since one that was given something else may say something else."""
    found: list[TopicDifference] = []
    doubts: list[Doubt] = []
    for answer, topics in plan.answers.items():
        own = run.doubts[answer]
        here = compare(
            recorded, replayed, {*topics}.intersection([*recorded.topics, *replayed.topics]),
            _answered(recorded, answer, run.played[answer], progress), tolerance, doubts + own)
        unjudged = {stamp: reason for topic in here for stamp, reason in topic.unjudged.items()}
        doubts += [Doubt(stamp, stamp, reason) for stamp, reason in unjudged.items()]
        doubts += [doubt for doubt in own if unjudged and doubt.last_ns == math.inf]
        found += here
    return found


def _answered(
    recorded: Recording, answer: str, stamps: set[int], progress: Console,
) -> set[int]:
    """The frames that a node answered when it was recorded; all, where it answered none.

    One that was started later, was ended earlier, or held poses for too old let frames pass.
    """
    answered = stamps.intersection(header_stamp_ns(message.data)
                                   for message in recorded.messages([answer])
                                   if answer in recorded.topics) or stamps
    if passed := len(stamps) - len(answered):
        progress.print(f'{answer}: left out {passed} of {len(stamps)} frames, which were not '
                       'answered when it was recorded', soft_wrap=True)
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
                      str(topic.only_b), str(len(topic.unjudged)), where, largest)
    return table


def _entry(topic: TopicDifference) -> dict[str, Any]:
    """A topic for JSON; what is no matter of numbers has no size."""
    first = topic.first
    return {
        'topic': topic.topic, 'compared': topic.pairs, 'differ': topic.unequal,
        'only_recorded': topic.only_a, 'only_replayed': topic.only_b,
        'not_judged': dict(Counter(topic.unjudged.values())),
        'first': None if first is None else {
            't_s': first.t_s, 'field': first.field, 'recorded': first.a, 'replayed': first.b},
        'largest': {field: size if math.isfinite(size) else None
                    for field, size in topic.largest.items()},
    }
