"""After the warm-up nothing is compiled any more, however many particles there are."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.rig

_PROGRAM = """
import importlib, pkgutil
import numpy as np
from bench._tracker_scenes import KINDS, draw, expose, light
from microbot_ros import tracking
from microbot_ros.tracking import Tracker, TrackerSettings, learn, warm_up
from microbot_ros.tracking.teach import teacher

def compiled():
    rooms = [importlib.import_module(found.name)
             for found in pkgutil.walk_packages(tracking.__path__, 'microbot_ros.tracking.')]
    return {(room.__name__, name): len(thing.signatures) for room in rooms
            for name, thing in vars(room).items() if hasattr(thing, 'signatures')}

warm_up()
before, rng = compiled(), np.random.default_rng(0)
for count in (1, 6, 90):
    places, frames = rng.uniform(20, 580, (count, 2)), []
    for _ in range(8):
        picture = light(600, 600)
        for place in places + rng.normal(0, 1.5, 2):
            draw(picture, place, KINDS['disc'], -60)
        frames.append(expose(picture, 3, rng))
    for shape in ('round', 'any'):
        settings = TrackerSettings(shape=shape)
        tracker = Tracker(settings, learn(frames, settings))
        for t, frame in enumerate(frames):
            tracker.update(frame, t / 60)
        later = compiled()
        assert later == before, [key for key in later if later[key] != before[key]]
    taught, _ = teacher.like(TrackerSettings(), frames[0], *places[0])
    tracker.teach(taught)
    tracker.update(frames[0], 1.0)
    later = compiled()
    assert later == before, [key for key in later if later[key] != before[key]]
"""


def test_nothing_is_compiled_after_the_warm_up() -> None:
    done = subprocess.run([sys.executable, '-c', _PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
