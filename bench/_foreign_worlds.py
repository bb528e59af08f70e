"""Sessions of simulators by other people: the family that discovery is never tuned on."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from bench._judge_cases import Case
from microbot_ros.model.vectors import unit
from microbot_ros.records import Commands, Conditions, Session
from microbot_ros.virtual_rig.record_session import as_tracks

PYTHON = Path('out/foreign/bin/python')
_FIELD = 5e-3
_FIRST_SEED = 400_000
_HELICES = 'helices of mime-engine'
_STEP_OUT = 'drive_response'


def judging_cases(count: int, missing: list[str]) -> list[Case]:
    """Each foreign world `count` times; sentences on what is not installed go to `missing`."""
    if not _installed('mime'):
        missing.append('judging: mime-engine is not installed; run `make foreign`')
        return []
    return [Case('judging', _HELICES, _FIRST_SEED + turn, effects, frozenset(effects), _helices)
            for turn in range(count) for effects in ((), (_STEP_OUT,))]


def _installed(module: str) -> bool:
    return PYTHON.exists() and not subprocess.run(
        [PYTHON, '-c', f'import {module}'], capture_output=True, check=False).returncode


def _helices(case: Case) -> Session:
    """Four helices under a field whose direction and frequency change in steps."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'session.npz'
        subprocess.run(
            [PYTHON, Path(__file__).parent / 'foreign' / 'mime_helices.py', str(case.seed),
             str(int(bool(case.effects))), file], check=True)
        with np.load(file) as made:
            tracks = as_tracks(made['t'], made['position'])
            commands = Commands(
                made['command_t'], _FIELD * unit(made['direction']), made['frequency'])
    conditions = Conditions('rolling', frame_rate=30.0, reference_field=_FIELD)
    return Session(tracks, commands, conditions, f'{case.kind} {case.seed}')
