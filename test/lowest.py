"""The tests of the core with the oldest libraries that setup.py allows: `make lowest`.

    python test/lowest.py FOLDER

makes an environment in FOLDER, or takes the one that is there, and runs in it the tests of the
rooms below the nodes, without a ROS graph. It ends as pytest does.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULT = 'result.json'
ROOMS = ('model', 'magnetics', 'estimation', 'tracking', 'session', 'control', 'drive', 'loop',
         'virtual_rig', 'discovery', 'cameras', 'cli')
# ROS is of one version; what only the tests need may be of any.
TOOLS = ('ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces', 'pytest', 'pytest-timeout',
         'hypothesis', 'psutil', 'magpylib', 'pyparsing<3.3')


def _in_setup(name: str) -> Any:
    """The literal that setup.py assigns to a `name` or passes to `setup` under it."""
    for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text(encoding='utf-8'))):
        if isinstance(node, ast.keyword) and node.arg == name:
            return ast.literal_eval(node.value)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return ast.literal_eval(node.value)
    raise LookupError(name)


def core() -> list[str]:
    """Return the requirements of the core, with their bounds."""
    required: list[str] = _in_setup('install_requires')
    return required


def features() -> dict[str, list[str]]:
    """Return the requirements of each extra that `all` includes."""
    extras: dict[str, list[str]] = _in_setup('features')
    return extras


def lowest() -> list[str]:
    """Return all of these, each at its bound: 'numpy==1.26.*' for 'numpy>=1.26'.

    A bound stands for its newest correction: nobody is helped by testing errors mended since.
    """
    return [re.sub(r'>=([\d.]+)$', r'==\1.*', name)
            for names in [core(), *features().values()] for name in names]


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
    status = subprocess.run(
        [python, '-m', 'pytest', '-m', 'not rig and not soak',
         *(f'test/{room}' for room in ROOMS)],
        cwd=ROOT, check=False, env={**environment, 'PYTHONPATH': str(ROOT),
                                    # Two versions of numba would take it from each other.
                                    'NUMBA_CACHE_DIR': str(folder / 'compiled')}).returncode
    (folder / RESULT).write_text(json.dumps({'commit': commit(), 'status': status}))
    return status


def commit() -> str:
    """Return the present commit; '' where the sources are not in git or are changed."""
    def git(*words: str) -> str:
        return subprocess.run(['git', *words], cwd=ROOT, check=False, capture_output=True,
                              text=True).stdout.strip()
    return '' if git('status', '--porcelain') else git('rev-parse', 'HEAD')


if __name__ == '__main__':
    sys.exit(main(Path(sys.argv[1]).absolute()))
