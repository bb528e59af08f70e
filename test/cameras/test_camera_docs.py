"""The package of the page is a camera like ours, once it is installed; the table is whole."""

import os
import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

from installed import install

from microbot_ros.cameras.camera import camera_class

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / 'docs' / 'examples' / 'my_cameras'


def test_a_package_of_its_own_adds_a_camera(tmp_path, monkeypatch):
    """Found by its name, and through the kit with the test that the package comes with."""
    installed = install(EXAMPLE, 'my_cameras', tmp_path)
    with monkeypatch.context() as patched:
        patched.syspath_prepend(str(installed))
        found = camera_class.__wrapped__('shared_memory')
    assert found.__module__ == 'my_cameras.shared_memory'
    ran = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', str(EXAMPLE)],
        env={**os.environ, 'PYTHONPATH': os.pathsep.join([str(installed), str(ROOT)])},
        cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_every_kind_is_in_the_table():
    page = (ROOT / 'docs' / 'reference' / 'cameras.md').read_text(encoding='utf-8')
    listed = re.findall(r'^\| `(\w+)` \| ', page.split('## The moment')[0], re.MULTILINE)
    assert sorted(listed) == sorted(
        point.name for point in entry_points(group='microbot_ros.cameras')
        if point.value.startswith('microbot_ros.'))
