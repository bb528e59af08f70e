"""The tests of `emulated.py`, in a process for each maker.

Their libraries have threads of their own, and one of them may end its process.
"""

import subprocess
import sys
from pathlib import Path

import pytest

ALL = Path(__file__).with_name('emulated.py')


@pytest.mark.rig
@pytest.mark.parametrize('kind', ['pylon', 'micromanager', 'aravis'])
def test_a_camera_does_as_asked(kind):
    done = subprocess.run([sys.executable, '-m', 'pytest', '-rs', str(ALL), '-k', kind],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    if ' passed' not in done.stdout:
        pytest.skip(done.stdout.split('SKIPPED')[-1])
