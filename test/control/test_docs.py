"""The controller in the documentation is one that works."""

import re
from pathlib import Path

import numpy as np
import pytest

from microbot_ros.control import registry
from microbot_ros.control.testkit import exercise, situation

PAGE = (Path(__file__).parents[2] / 'docs' / 'controllers.md').read_text(encoding='utf-8')


def test_the_template_keeps_the_contract_and_goes_north():
    source = next(block for block in re.findall(r'```python\n(.*?)```', PAGE, re.DOTALL)
                  if 'class Northwards' in block)
    space = {'__name__': 'template'}
    exec(source, space)
    exercise(space['Northwards'])
    controller = space['Northwards']()
    shown = situation(1, phi=np.array([0.5]))
    field = controller.compute(shown).field
    assert np.arctan2(field[1], field[0]) == pytest.approx(np.pi / 2 - 0.5)


def test_every_controller_is_in_the_table():
    listed = set(re.findall(r'^\| `(\w+)` \|', PAGE, re.MULTILINE))
    ours = {name for name, kind in registry.controller_classes().items()
            if kind.__module__.startswith('microbot_ros.')}
    assert listed == ours
