"""The tests of the core with the oldest libraries that setup.py allows: `make lowest`.

    python test/lowest.py FOLDER

makes an environment in FOLDER, or takes the one that is there, and runs in it the tests of the
rooms below the nodes, without a ROS graph. It ends as pytest does.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ('model', 'magnetics', 'estimation', 'tracking', 'session', 'control', 'drive', 'loop',
         'virtual_rig', 'discovery', 'cameras', 'cli')
# ROS is of one version; what only the tests need may be of any.
TOOLS = ('ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces', 'pytest', 'pytest-timeout',
         'hypothesis', 'psutil', 'magpylib', 'pyparsing<3.3')


def lowest() -> list[str]:
    """What setup.py requires, each at its bound: 'numpy==1.26.*' for 'numpy>=1.26'.

    A bound stands for its newest correction: nobody is helped by testing errors mended since.
    """
    tree = ast.parse((ROOT / 'setup.py').read_text(encoding='utf-8'))
    required = next(keyword.value for node in ast.walk(tree) if isinstance(node, ast.Call)
                    for keyword in node.keywords if keyword.arg == 'install_requires')
    return [re.sub(r'>=([\d.]+)$', r'==\1.*', name) for name in ast.literal_eval(required)]


def main(folder: Path) -> int:
    """Make the environment in `folder` and run the tests; the exit status of pytest."""
    python = folder / 'bin' / 'python'
    if not python.exists():
        venv.create(folder, with_pip=True)
    subprocess.run([python, '-m', 'pip', 'install', '--quiet', *lowest(), *TOOLS], check=True)
    # For its entry points; the code that runs is that of the sources.
    subprocess.run([python, '-m', 'pip', 'install', '--quiet', '--no-deps', ROOT], check=True)
    environment = {name: value for name, value in os.environ.items()
                   # Without CI what needs an extra may be skipped.
                   if name not in ('LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE', 'CI')}
    return subprocess.run(
        [python, '-m', 'pytest', '-m', 'not rig and not soak',
         *(f'test/{room}' for room in ROOMS)],
        cwd=ROOT, check=False, env={**environment, 'PYTHONPATH': str(ROOT),
                                    # Two versions of numba would take it from each other.
                                    'NUMBA_CACHE_DIR': str(folder / 'compiled')}).returncode


if __name__ == '__main__':
    sys.exit(main(Path(sys.argv[1]).absolute()))
