"""The rig asks through a real graph, in real time, and what that costs the loop.

Processes, pictures, a serial line; one with the virtual rig stands for what hardware does. Effects
are hidden in it, and nothing is in a rig whose inside is not ours (`bench._software_timed_rig`).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench import _rig
from bench._asks_worlds import hidden_world
from bench._emulator import FULL_SCALE_A, EmulatorProcess
from bench._hidden_effects import LISTED
from bench._hidden_suite import FLUID
from bench._kept import run_kept
from bench.discovery import interval
from bench.figure import Figure
from microbot_ros.nodes.client.graph_client import GraphClient

ISSUE = 34
_OF_SWIMMERS = [effect for effect in LISTED if effect != 'drive_response']
SEARCHES = [(effect, seed) for seed in (1, 2) for effect in (*_OF_SWIMMERS[::2], _OF_SWIMMERS[-1])]
"""What is hidden in the virtual rig, and the seed: ten effects of swimmers, twice."""
QUIET = [('', seed) for seed in range(20)]
"""Searches where nothing is hidden, in the software-timed rig."""
_MINUTES, _RATE_HZ, _SOFTWARE_RATE_HZ = 6.0, 20.0, 30.0
_WARM_S, _BEFORE_S, _LOOK_S = 5.0, 10.0, 0.5


@dataclass
class Asked:
    """What came of an effect that was `hidden`, or of none; answers of the loop [s] without and
    beside the search.
    """

    hidden: str
    seed: int
    decided: str
    verdict: str
    named: dict[str, float]
    """Of each established effect its first parameter, in its own unit."""

    minutes: float
    before_s: list[float] = field(repr=False)
    beside_s: list[float] = field(repr=False)

    @property
    def found(self) -> bool:
        """Whether what was hidden is named, and the search settled."""
        return self.decided == 'settled' and self.hidden in self.named

    @property
    def alone(self) -> bool:
        """Whether nothing is named besides."""
        return not set(self.named) - {self.hidden}


def figures() -> list[Figure]:
    """Of some four and a half hours; each search is kept in `out/asks_graph.jsonl`."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(215 + os.getpid() % 17))  # nobody else's graph
    return score(run_kept(Path('out/asks_graph.jsonl'), SEARCHES + QUIET, ask,
                          lambda told: Asked(**told), jobs=1))


def score(asked: Sequence[Asked]) -> list[Figure]:
    """How many are named, and alone; what is said of nothing; how much later the loop answers."""
    searches = [one for one in asked if one.hidden]
    before, beside = (float(np.percentile(np.concatenate(spent), 99)) for spent in (
        [one.before_s for one in asked], [one.beside_s for one in asked]))
    return [
        _share('through the real graph: named within 6 min', searches, lambda one: one.found),
        _share('through the real graph: nothing beside', searches, lambda one: one.alone),
        _share('a software-timed rig with nothing hidden: consistent',
               [one for one in asked if not one.hidden], lambda one: one.verdict == 'consistent'),
        Figure(ISSUE, 'loop p99 beside a search over without', beside / before, '1', '≤ 1.1',
               f'{1e3 * beside:.1f} and {1e3 * before:.1f} ms', beside <= 1.1 * before)]


def _share(name: str, asked: Sequence[Asked], holds: Callable[[Asked], bool]) -> Figure:
    """A share of at least 95 %, with its exact interval and whom it does not hold for."""
    hits = sum(map(holds, asked))
    low, high = interval(hits, len(asked))
    others = '; '.join(f'{one.hidden or "nothing"}, seed {one.seed}: {one.decided}, '
                       f'{one.verdict}, {one.named}' for one in asked if not holds(one))
    return Figure(ISSUE, name, hits / len(asked), '1', '≥ 0.95',
                  f'{hits} of {len(asked)} ({100 * low:.0f}–{100 * high:.0f} %){others and ": "}'
                  f'{others}', hits >= 0.95 * len(asked))


def ask(case: tuple[str, int]) -> Asked:
    """Hide an effect in the virtual rig, at its strength in a world, and let the rig ask.

    Nothing is hidden in the software-timed rig.
    """
    effect, seed = case
    with tempfile.TemporaryDirectory(prefix='bench-asks-') as name:
        folder = Path(name)
        instead = {} if effect else {'virtual_rig': 'bench._software_timed_rig'}
        with (EmulatorProcess(folder) as board,
              _rig.graph(folder, _nodes(effect, seed, folder, board), instead),
              GraphClient('bench') as client):
            answers = _rig.listen(client)
            _rig.drive(client, answers, _WARM_S)
            answers.written_s.clear()
            _rig.drive(client, answers, _BEFORE_S)
            before = list(answers.written_s)
            answers.written_s.clear()
            found = _discovered(client, folder / 'asked')
            named = {one['id']: next(iter(one['parameters'].values()))['value']
                     for one in found['effects'] if one['status'] == 'established'}
            return Asked(effect, seed, found['decided'], found['verdict'], named,
                         found['minutes'], before, answers.written_s)


def _nodes(effect: str, seed: int, folder: Path, board: EmulatorProcess,
           ) -> dict[str, dict[str, Any]]:
    """The nodes and their parameters: the particles of that world, on a stage of ours."""
    rig, hidden = hidden_world(seed, (effect,) if effect else ())
    swarm, body = rig.world.bodies, {
        'radius_um': 1e6 * rig.conditions.radius, 'viscosity_mPa_s': 1e3 * FLUID.viscosity}
    return {
        'virtual_rig': {
            'amplifier_log': str(folder / 'serial_transfer.jsonl'), 'seed': seed,
            'frame_rate_hz': _RATE_HZ if effect else _SOFTWARE_RATE_HZ,
            'temperature_K': FLUID.temperature, 'speeds_um_s': (1e6 * swarm['speed']).tolist(),
            'phis_rad': swarm['phi'].tolist(), 'alignment_ms': 0.1, **body, **({
                'effect': effect,
                'effect_parameters': [f'{key}={value}' for key, value in hidden[effect].items()],
            } if effect else {})},
        'tracker': {'pixel_size_um': 0.45}, 'model': body,
        'controller': _rig.TURNING | {'deadline_ms': 100.0},
        'coil_driver': {'port': str(board.url), 'full_scale_A': FULL_SCALE_A,
                        'command_timeout_ms': 400.0, 'max_command_age_ms': 400.0}}


def _discovered(client: GraphClient, out: Path) -> dict[str, Any]:
    """What `microbot discover --drive` wrote, while the `client` listens."""
    with subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'discover', '--drive', '--out', str(out),
             '--minutes', str(_MINUTES)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            text=True) as process:
        while process.poll() is None:
            client.spin(_LOOK_S)
        assert process.stderr is not None
        said = process.stderr.read()
    if not (out / 'result.json').exists():
        raise RuntimeError(said.strip())
    found: dict[str, Any] = json.loads((out / 'result.json').read_text())
    return found
