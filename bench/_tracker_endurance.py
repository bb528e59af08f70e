"""Whether the tracker grows with time: a day of frames, small ones."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from bench._tracker_scenes import KINDS, draw, expose, light
from bench.figure import Figure
from microbot_ros.tracking import Tracker, TrackerSettings, learn

_SIDE = 64
_LOOP = 96


def memory(frames: int = 100_000) -> Figure:
    """Resident memory at the end over that at a tenth, while particles come, cross and go."""
    pictures = _stream()
    settings = TrackerSettings(shape='round')
    tracker = Tracker(settings, learn(pictures[:10], settings))
    early, names = 0.0, 0
    for t in range(frames):
        if t == frames // 10:
            early = _resident_mib()
        turn = t // 50
        poses = tracker.update(pictures[t % _LOOP], t / 60, np.array(
            [np.cos(turn), np.sin(turn)]) / 60)
        names = max(names, int(poses.id.max(initial=0)))
    grown = _resident_mib() - early
    return Figure(8, f'memory gained from frame {frames // 10} to {frames} ({_SIDE}×{_SIDE} px, '
                  f'{names + 1} particles came by)', grown, 'MiB', '≤ 1', '', grown <= 1)


def _stream() -> list[np.ndarray]:
    """A loop of frames: four particles cross the field and leave, two lanes each way."""
    rng = np.random.default_rng(7)
    lamp = light(_SIDE, _SIDE)
    pictures = []
    for t in range(_LOOP):
        picture = lamp.copy()
        for lane, way in ((12, 1), (25, -1), (38, 1), (51, -1)):
            x = way * (t + 7 * lane) * 96 / _LOOP % 96 - 16
            draw(picture, np.array([x, lane + 5 * np.sin(t / 9 + lane)]), KINDS['spot'], -60)
        pictures.append(expose(picture, 3.0, rng))
    return pictures


def _resident_mib() -> float:
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 2**20
