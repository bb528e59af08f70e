"""Compile all that numba compiles, once, before several processes need it: `make compiled`.

Compiled code is kept below `CACHE` by the content of its sources, so this takes two minutes after
a change and a moment otherwise.
"""

from __future__ import annotations

import hashlib
import io
import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / 'config'
CACHE = Path(os.environ.setdefault('NUMBA_CACHE_DIR', str(
    Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache') / 'microbot_ros' / 'numba')))
"""Where the tests and the benchmarks keep compiled code."""

LATE = 'numpy' in sys.modules and 'OMP_NUM_THREADS' not in os.environ
"""Whether something, as a plugin of pytest, has imported numpy before its threads are limited."""
# As the program `microbot` does: several threads for matrices of a hundred rows take four times
# the processor time. OpenBLAS reads this when numpy is imported.
os.environ.setdefault('OMP_NUM_THREADS', '1')

FILM = """
duration_s: 8
seed: 1
radius_um: 2.3
reference_field_mT: 5.0
fluid: {viscosity_mPa_s: 1.245}
camera: {frame_rate_hz: 30, localisation_um: 0.1}
"""
SWIMMERS = """
particles:
  - {x_um: -30, y_um: 20, v_um_s: 3.71, phi_rad: -1.09}
  - {x_um: 30, y_um: 30, v_um_s: 4.38, phi_rad: 3.82}
"""
STEPS = 'commands: {steps: {field_mT: 5.0, dwell_s: [1, 2]}}\n'
SCENARIOS = {
    'plain': FILM.replace('8', '12', 1) + SWIMMERS + STEPS,
    'first_order': FILM + SWIMMERS + STEPS + 'physics: first_order\n',
    'pairs': FILM + SWIMMERS + STEPS + 'effects: {dipole_interaction: {strength_um5_s: 1e4}, '
                                       'hydrodynamic_slowdown: {length_um: 1}}\n',
    'lag': FILM.replace('8', '12', 1) + SWIMMERS + STEPS
    + 'effects: {alignment_lag: {tau_s: 0.4}}\n',
    'pictures': FILM.replace('8', '3', 1) + SWIMMERS
    + 'controller: {name: predictive, goals_um: [[9, -9], [-9, -9]], pictures: true}\n',
    'waypoint': FILM + SWIMMERS + 'controller: {name: waypoint, goals_um: [[9, -9], [-9, -9]]}\n',
}


def sources() -> list[Path]:
    """Files of the package with compiled functions."""
    return sorted(file for file in (ROOT / 'microbot_ros').rglob('*.py')
                  if 'compiled import numba' in file.read_text('utf-8'))


def compile_all(folder: Path) -> None:
    """Run what calls compiled functions, in a `folder` for its files."""
    import numpy as np

    from microbot_ros.cli import microbot
    from microbot_ros.common.files import read_yaml
    from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings
    from microbot_ros.tracking.warm import warm_up
    from microbot_ros.virtual_rig.rolling import Rolling

    def run(*words: object) -> None:
        microbot.main([str(word) for word in words], standalone_mode=False)

    warm_up(np.uint8)
    warm_up(np.uint16)
    for settings in (CoilSettings(), read_yaml(CONFIG / 'coils_eight.yaml', CoilSettings)):
        Allocator(CoilSet(settings))
    Rolling(4e4).take(np.linspace(0, 0.1, 9), np.full((9, 3), 1e-3), 0.1)
    for name, text in SCENARIOS.items():
        (folder / f'{name}.yaml').write_text(text)
        run('simulate', folder / f'{name}.yaml', '--out', folder / name)
    run('fit', folder / 'plain', '--out', folder / 'fit')
    for name in ('plain', 'lag'):
        run('discover', folder / name, '--out', folder / f'found_{name}')


def main() -> None:
    """Compile, unless these sources were compiled before."""
    from microbot_ros.common.compiled.cache import digest

    digests = [digest(file) for file in sources()]
    done = CACHE / f'all-{hashlib.sha256("".join(digests).encode()).hexdigest()[:16]}'
    if not done.exists():
        print('compiling, about two minutes')
        with TemporaryDirectory() as folder, redirect_stdout(io.StringIO()), \
                redirect_stderr(io.StringIO()):
            compile_all(Path(folder))
        done.touch()


if __name__ == '__main__':
    main()
