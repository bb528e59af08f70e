"""Wheels of all that is compiled exist for the platforms that are said to work, by the index."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import pytest
from lowest import core, features

pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]
PYTHONS = ['3.11', '3.12', '3.13']
_NO_INDEX = ('Failed to establish a new connection', 'Temporary failure in name resolution')


def resolve(python: str, machine: str, target: Path, requirements: Sequence[str],
            *options: str) -> str:
    """What pip says against wheels of all `requirements` for that Python on that machine; '' for
    nothing. Nothing is installed."""
    platforms = [f'--platform=manylinux_2_{glibc}_{machine}' for glibc in range(17, 40)]
    done = subprocess.run(
        [sys.executable, '-m', 'pip', 'install', '--dry-run', '--quiet', '--ignore-installed',
         '--only-binary', ':all:', '--target', str(target), '--python-version', python,
         f'--platform=manylinux2014_{machine}', *platforms, *options, *requirements],
        capture_output=True, text=True)
    if any(words in done.stderr for words in _NO_INDEX):
        pytest.skip('the index cannot be reached')
    return done.stderr[-2000:] if done.returncode else ''


@pytest.mark.parametrize('python', PYTHONS)
@pytest.mark.parametrize('machine', ['x86_64', 'aarch64'])
def test_core_and_extras_have_wheels(machine: str, python: str, tmp_path: Path) -> None:
    assert not resolve(python, machine, tmp_path, [*core(), *chain(*features().values())])


@pytest.mark.parametrize('python', PYTHONS)
def test_ros_has_wheels_for_x86_alone(python: str, tmp_path: Path) -> None:
    """As docs/reference/conventions.md says."""
    assert not resolve(python, 'x86_64', tmp_path, ['ros-rclpy'], '--no-deps')
    assert resolve(python, 'aarch64', tmp_path, ['ros-rclpy'], '--no-deps')
