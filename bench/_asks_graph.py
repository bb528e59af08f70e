"""The rig asks through a real graph: a sample of the worlds, in real time, and what that costs the
loop. Processes, pictures, a serial line; one with the virtual rig stands for what hardware does.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench import _rig
from bench._asks_worlds import hidden_world
from bench._emulator import FULL_SCALE_A, EmulatorProcess
from bench._hidden_effects import LISTED
from bench._hidden_suite import FLUID
from bench.figure import Figure
from microbot_ros.nodes.client.graph_client import GraphClient

ISSUE = 18
SAMPLE = list(LISTED)[::4]
"""Of swimmers, all of them."""
_SEED, _MINUTES, _RATE_HZ = 0, 6.0, 20.0
_WARM_S, _BEFORE_S, _LOOK_S = 5.0, 60.0, 0.5


@dataclass
class Asked:
    """What came of an effect that was `hidden`; answers of the loop [s] without and beside it."""

    hidden: str
    decided: str
    named: dict[str, float]
    """Of each effect its first parameter, in its own unit."""

    minutes: float
    before_s: list[float] = field(repr=False)
    beside_s: list[float] = field(repr=False)

    @property
    def found(self) -> bool:
        """Whether what was hidden is named, and the search settled."""
        return self.decided == 'settled' and self.hidden in self.named


def figures() -> list[Figure]:
    """Of some twenty minutes."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(215 + os.getpid() % 17))  # nobody else's graph
    asked = []
    for effect in SAMPLE:
        asked.append(ask(effect))
        print(f'bench: asks, through the graph: {asked[-1]}', file=sys.stderr, flush=True)
    return score(asked)


def score(asked: Sequence[Asked]) -> list[Figure]:
    """How many are named, and alone, and how much later the loop answers beside a search."""
    found = [one for one in asked if one.found]
    named = len(found) / len(asked)
    alone = sum(len(one.named) == 1 for one in found) / len(asked)
    before, beside = (float(np.percentile(np.concatenate(spent), 99)) for spent in (
        [one.before_s for one in asked], [one.beside_s for one in asked]))
    told = '; '.join(f'{one.hidden}: {one.decided} after {one.minutes:.1f} min, ' + ', '.join(
        f'{name} {value:.2g}' for name, value in one.named.items()) for one in asked)
    return [
        Figure(ISSUE, 'through the real graph: named within 6 min', named, '1', '≥ 0.95', told,
               named >= 0.95),
        Figure(ISSUE, 'through the real graph: and nothing beside', alone, '1', '≥ 0.95',
               'a lag of the rig itself counts as wrong', alone >= 0.95),
        Figure(ISSUE, 'loop p99 beside a search over without', beside / before, '1', '≤ 1.1',
               f'{1e3 * beside:.1f} and {1e3 * before:.1f} ms', beside <= 1.1 * before)]


def ask(effect: str) -> Asked:
    """Hide an `effect` in the virtual rig, at its strength in a world, and let the rig ask."""
    with tempfile.TemporaryDirectory(prefix='bench-asks-') as name:
        folder = Path(name)
        with (EmulatorProcess(folder) as board,
              _rig.graph(folder, _nodes(effect, folder, board)),
              GraphClient('bench') as client):
            answers = _rig.listen(client)
            _rig.drive(client, answers, _WARM_S)
            answers.written_s.clear()
            _rig.drive(client, answers, _BEFORE_S)
            before = list(answers.written_s)
            answers.written_s.clear()
            found = _discovered(client, folder / 'asked')
            named = {one['id']: next(iter(one['parameters'].values()))['value']
                     for one in found['effects']}
            return Asked(effect, found['decided'], named, found['minutes'], before,
                         answers.written_s)


def _nodes(effect: str, folder: Path, board: EmulatorProcess) -> dict[str, dict[str, Any]]:
    """The nodes and their parameters: the particles of that world, on a stage of ours."""
    rig, hidden = hidden_world(_SEED, (effect,))
    swarm, body = rig.world.bodies, {
        'radius_um': 1e6 * rig.conditions.radius, 'viscosity_mPa_s': 1e3 * FLUID.viscosity}
    return {
        'virtual_rig': {
            'amplifier_log': str(folder / 'serial_transfer.jsonl'), 'frame_rate_hz': _RATE_HZ,
            'temperature_K': FLUID.temperature, 'speeds_um_s': (1e6 * swarm['speed']).tolist(),
            'phis_rad': swarm['phi'].tolist(), 'alignment_ms': 0.1, 'effect': effect,
            'effect_parameters': [f'{key}={value}' for key, value in hidden[effect].items()],
            **body},
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
