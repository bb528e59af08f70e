"""Worlds of other people, the family that discovery is never tuned on: simulators and curves."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import openpyxl

from bench._judge_cases import Case
from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.model.physics.particle import Fluid, translational_diffusion
from microbot_ros.model.physics.vectors import as_complex, as_vectors, unit
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.record_session import as_tracks

PYTHON = Path('out/foreign/bin/python')
_TABLES = Path(__file__).parents[2] / 'shared' / 'data' / 'speed_vs_frequency'
_FIELD = 5e-3
_FIRST_SEED = 400_000
_KINDS = {
    'helices of mime-engine': ('mime', 'mime_helices.py', 'drive_response'),
    'spheres of pystokes': ('pystokes', 'pystokes_spheres.py', 'uniform_drift'),
}
"""Kind → module that must be installed, script, effect of the library that it can hide."""
_CURVES = {
    'curves of 20 µm spheres': '20umspeedvsfreqdata.xlsx',
    'curves of 20 µm dimers': '20umdimerspeedvsfreqdata.xlsx',
    'curves of cells': '1botcellbot_total.xlsx',
}
"""Kind → a laboratory's table: frequency [Hz], and the mean speed [µm/s] of each robot."""
_SECONDS, _RATE, _STEPS = 60, 30, 40
_DIFFUSION = translational_diffusion(Fluid(1e-3), 10e-6)
_LOCALISATION = 0.2e-6


def judging_cases(count: int, missing: list[str]) -> list[Case]:
    """Each foreign world `count` times; sentences on what is not there go to `missing`."""
    cases = []
    for kind, (module, _, effect) in _KINDS.items():
        if not installed(module):
            missing.append(f'judging: {kind} left out: {module} is not installed; '
                           'run `make foreign`')
            continue
        cases += _cases(kind, effect, count, _film)
    for kind, table in _CURVES.items():
        if (_TABLES / table).exists():
            cases += _cases(kind, 'drive_response', count, _follow_curves)
        else:
            missing.append(f'judging: {kind} left out: {table} is not among the shared recordings')
    return cases


def _cases(kind: str, effect: str, count: int, film: Callable[[Case], Session]) -> list[Case]:
    return [Case('judging', kind, _FIRST_SEED + turn, effects, frozenset(effects), film)
            for turn in range(count) for effects in ((), (effect,))]


def installed(module: str) -> bool:
    """Whether the environment of `make foreign` has a module."""
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
    return _session(case, tracks, commands)


def _session(case: Case, tracks: Tracks, commands: Commands) -> Session:
    propulsion = 'catalytic' if commands.frequency is None else 'rolling'
    conditions = Conditions(propulsion, frame_rate=_RATE, reference_field=_FIELD)
    return Session(tracks, commands, conditions, f'{case.kind} {case.seed}')


def _follow_curves(case: Case) -> Session:
    """Let robots roll as fast as a laboratory measured, or without an effect in proportion.

    Only frequencies of the table are commanded.
    """
    rng = np.random.default_rng(case.seed)
    frequencies, speeds = _curves(_TABLES / _CURVES[case.kind])
    if not case.effects:
        speeds = np.outer(frequencies, np.mean(speeds / frequencies[:, None], axis=0))
    commands = steps(rng, _SECONDS, _FIELD, (1.5, 4.0), frequency=frequencies)
    assert commands.frequency is not None
    t, step = np.arange(_SECONDS * _RATE) / _RATE, 1 / (_RATE * _STEPS)
    row = commands.index_at((np.arange(_SECONDS * _RATE * _STEPS) + 0.5) * step)
    velocity = as_complex(commands.field / _FIELD)[:, None] * speeds[
        np.searchsorted(frequencies, commands.frequency)]
    turned = np.exp(1j * rng.uniform(-np.pi, np.pi, speeds.shape[1]))
    moved = step * turned * velocity[row]
    moved += np.sqrt(2 * _DIFFUSION * step) * (rng.standard_normal((*moved.shape, 2)) @ [1, 1j])
    place = np.cumsum(moved, axis=0)[::_STEPS] + 100e-6 * np.arange(speeds.shape[1])
    position = as_vectors(place)
    position += _LOCALISATION * rng.standard_normal(position.shape)
    return _session(case, as_tracks(t, position), commands)


def _curves(table: Path) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) [Hz] and speeds (F, N) [m/s] of the robots measured at all of them.

    log v is a parabola in log f, fitted to the table: there v scatters by some 6 % from one
    frequency to the next, since its means are over times in which robots also turn.
    """
    sheet = openpyxl.load_workbook(table, read_only=True, data_only=True).worksheets[0]
    rows = np.array([row[:6] for row in sheet.iter_rows(min_row=2, values_only=True)], float)
    measured = rows[:, 1:][:, np.isfinite(rows[:, 1:]).all(axis=0)]
    powers = np.vander(np.log(rows[:, 0]), 3)
    fitted = powers @ np.linalg.lstsq(powers, np.log(measured), rcond=None)[0]
    return rows[:, 0], 1e-6 * np.exp(fitted)
