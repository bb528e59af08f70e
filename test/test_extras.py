"""The core runs without the libraries of the extras, and names the extra that a feature needs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import lowest
import pytest
import warm

from microbot_ros.common.extras import EXTRAS, advice
from microbot_ros.nodes.client.graph import READY
from microbot_ros.nodes.process import NODES

ROOT = Path(__file__).parents[1]
WITHOUT = f"""
import sys
from importlib.machinery import PathFinder
known = PathFinder.find_spec
PathFinder.find_spec = classmethod(lambda _, name, *more: (
    None if name.partition('.')[0] in {sorted(EXTRAS)!r} else known(name, *more)))
"""
"""Python without the libraries of all extras, also where they are installed."""


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, '-c', WITHOUT + code, *arguments]
    return subprocess.run(words, cwd=ROOT, timeout=100,
                          env=dict(os.environ), capture_output=True, text=True)


def test_matrices_are_solved_by_one_thread() -> None:
    """Several take four times the processor time for those of this package."""
    assert not warm.LATE, 'a plugin of pytest imports numpy: add -p no:PLUGIN to pyproject.toml'
    code = """if True:
        import os, sys
        from microbot_ros import cli
        assert 'numpy' not in sys.modules
        sys.argv[1:] = ['discover', '--help']
        try:
            cli.main()
        finally:
            print(os.environ['OMP_NUM_THREADS'])"""
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True,
        env={name: value for name, value in os.environ.items() if name != 'OMP_NUM_THREADS'})
    assert done.stdout.splitlines()[-1] == '1', done.stderr


def test_every_library_of_an_extra_is_named() -> None:
    """The table and setup.py agree on which extra installs what."""
    for extra, libraries in lowest.features().items():
        for library in libraries:
            assert EXTRAS[library.partition('>')[0]] == extra
    assert set(EXTRAS.values()) >= set(lowest.features())


def test_nodes_need_only_the_core() -> None:
    """Import only: what a node does with a library of an extra, it asks for when it does it."""
    nodes = sorted(set(NODES) - {'cockpit'})
    done = run('import ' + ', '.join(f'microbot_ros.nodes.{node}' for node in nodes))
    assert done.returncode == 0, done.stderr


def test_no_command_needs_an_extra_to_explain_itself() -> None:
    from microbot_ros.cli import _COMMANDS

    modules = ', '.join(f'microbot_ros.cli.{module}' for module, _ in _COMMANDS.values())
    done = run(f'import {modules}')
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(('words', 'library', 'extra'), [
    ('info nothing.mcap', 'rich', 'analysis'),
    ('discover nothing --out out', 'rich', 'analysis'),
])
def test_a_command_names_the_extra_that_it_lacks(
    words: str, library: str, extra: str, tmp_path: Path,
) -> None:
    done = run(f'import os; os.chdir({str(tmp_path)!r})\n'
               'from microbot_ros.cli import main; main()',
               *words.split())
    assert done.returncode == 2
    assert done.stderr == (f"microbot: the library '{library}' is not installed; "
                           f"pip install 'microbot_ros[{extra}]'\n")
    assert not list(tmp_path.iterdir())


def test_another_missing_module_is_an_error_of_ours() -> None:
    assert advice(ModuleNotFoundError(name='microbot_ros.nothing')) is None
    assert advice(ModuleNotFoundError()) is None
    assert advice(ModuleNotFoundError(name='mcap.reader')) is not None


def test_the_demo_names_all_that_it_lacks_before_it_begins(tmp_path: Path) -> None:
    done = run(f'import os; os.chdir({str(tmp_path)!r})\n'
               'from microbot_ros.cli import main; main()', 'demo', '--out', 'out')
    assert done.returncode == 2
    assert done.stderr == (
        'microbot: not installed: av, lz4, mcap, rosbags, zstandard, jinja2, matplotlib, '
        "openpyxl, rich; pip install 'microbot_ros[video,mcap,analysis]'\n")
    assert not list(tmp_path.iterdir())


def test_a_rig_runs_without_recording_and_says_so() -> None:
    code = WITHOUT + 'from microbot_ros.nodes.process import main; main()'
    with subprocess.Popen([sys.executable, '-c', code, 'recorder'], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as recorder:
        assert recorder.stdout is not None
        said = ''
        while READY not in said:
            said += recorder.stdout.readline() or pytest.fail(said)
        recorder.send_signal(signal.SIGINT)
        said += recorder.communicate(timeout=60)[0]
    assert recorder.returncode == 0
    assert 'not recording: not installed: lz4, mcap, rosbags, zstandard; pip install' in said


def test_a_controller_without_its_solver_is_left_out() -> None:
    done = run('from microbot_ros.control.registry import controller_classes\n'
               "print(*controller_classes('hold'))")
    assert 'waypoint' in done.stdout.split()
    assert 'predictive' not in done.stdout.split()
    assert "pip install 'microbot_ros[predictive]'" in done.stderr
