"""The package in the documentation works as another package would, and the table is whole."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from installed import install

from microbot_ros.control import registry

DOCS = Path(__file__).parents[2] / 'docs'
TEMPLATE = DOCS / 'template'
USE = """
import numpy as np
from microbot_ros.control.registry import controller_classes
from microbot_ros.control.manager import ControllerManager
from microbot_ros.control.testkit import controller_input, exercise
kinds = controller_classes(required='northwards')
assert 'waypoint' in kinds
exercise(kinds['northwards'])
manager = ControllerManager({name: kind() for name, kind in kinds.items()}, 'hold', deadline=30.0)
shown = controller_input(1, dt=1.0, phi=np.array([0.5]))
manager.tick(shown)
assert manager.switch_controller('northwards').ok
x, y = manager.tick(shown).command.field
print(round(np.arctan2(y, x), 6), kinds['northwards'].__module__)
"""


@pytest.fixture
def installed(tmp_path):
    """A folder on the path of Python with the template in it, as an installer leaves it."""
    return install(TEMPLATE, 'my_lab', tmp_path)


def test_a_package_of_its_own_adds_a_controller(installed):
    pytest.importorskip('osqp')
    run = subprocess.run([sys.executable, '-c', USE], capture_output=True, text=True, timeout=120,
                         env={**os.environ, 'PYTHONPATH': str(installed)}, check=False)
    assert run.stderr == ''
    assert run.stdout.split() == [f'{1.570796 - 0.5:.6f}', 'my_lab.northwards']


def test_every_controller_is_in_the_table():
    pytest.importorskip('osqp')
    page = (DOCS / 'reference/controllers.md').read_text(encoding='utf-8')
    listed = set(re.findall(r'^\| `(\w+)` \|', page, re.MULTILINE))
    ours = {name for name, kind in registry.controller_classes().items()
            if kind.__module__.startswith('microbot_ros.')}
    assert listed == ours
