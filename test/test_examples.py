"""The examples in the docstrings of the rooms run, and print what they say."""

import doctest
import importlib
from pathlib import Path

import pytest

import microbot_ros

ROOMS = sorted(
    path.parent.name for path in Path(microbot_ros.__file__).parent.glob('*/__init__.py'))
NEEDS = {'gym': 'gymnasium', 'nodes': 'rclpy'}


@pytest.mark.parametrize('room', ROOMS)
def test_each_room_has_an_example_that_runs(room):
    if room in NEEDS:
        pytest.importorskip(NEEDS[room])
    found = doctest.testmod(importlib.import_module(f'microbot_ros.{room}'))
    assert found.attempted > 0
    assert found.failed == 0
