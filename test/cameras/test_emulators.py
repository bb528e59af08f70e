"""The tests of `emulated.py`, in a process for each maker.

Their libraries have threads of their own, and one of them may end its process.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from bench._aravis import has_aravis

ALL = Path(__file__).with_name('emulated.py')


@pytest.mark.rig
@pytest.mark.parametrize('kind', ['pylon', 'micromanager', pytest.param(
    'aravis', marks=pytest.mark.skipif(not has_aravis(), reason='needs Aravis and PyGObject'))])
def test_a_camera_does_as_asked(kind):
    others = {'pylon', 'micromanager', 'aravis'} - {kind}
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', str(ALL), '-k', f'not {" and not ".join(others)}'],
        capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
