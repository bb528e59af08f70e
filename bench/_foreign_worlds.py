"""Sessions of simulators by other people: the family that discovery is never tuned on."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from bench._judge_cases import Case
from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.model.physics.vectors import unit
from microbot_ros.virtual_rig.record_session import as_tracks

PYTHON = Path('out/foreign/bin/python')
_FIELD = 5e-3
_FIRST_SEED = 400_000
_KINDS = {
    'helices of mime-engine': ('mime', 'mime_helices.py', 'drive_response'),
    'spheres of pystokes': ('pystokes', 'pystokes_spheres.py', 'uniform_drift'),
}
"""Kind → module that must be installed, script, effect of the library that it can hide."""


def judging_cases(count: int, missing: list[str]) -> list[Case]:
    """Each foreign world `count` times; sentences on what is not installed go to `missing`."""
    cases = []
    for kind, (module, _, effect) in _KINDS.items():
        if not _installed(module):
            missing.append(f'judging: {kind} left out: {module} is not installed; '
                           'run `make foreign`')
            continue
        cases += [
            Case('judging', kind, _FIRST_SEED + turn, effects, frozenset(effects), _film)
            for turn in range(count) for effects in ((), (effect,))]
    return cases


def _installed(module: str) -> bool:
    return PYTHON.exists() and not subprocess.run(
        [PYTHON, '-c', f'import {module}'], capture_output=True, check=False).returncode


def _film(case: Case) -> Session:
    """Run the script of a foreign world on one core and read what it wrote."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'session.npz'
        script = Path(__file__).parent / 'foreign' / _KINDS[case.kind][1]
        subprocess.run(
            [PYTHON, script, str(case.seed), str(int(bool(case.effects))), file], check=True,
            env=os.environ | {'OMP_NUM_THREADS': '1'})
        with np.load(file) as made:
            tracks = as_tracks(made['t'], made['position'])
            commands = Commands(made['command_t'], _FIELD * unit(made['direction']),
                                made.get('frequency'))
    propulsion = 'catalytic' if commands.frequency is None else 'rolling'
    conditions = Conditions(propulsion, frame_rate=30.0, reference_field=_FIELD)
    return Session(tracks, commands, conditions, f'{case.kind} {case.seed}')
