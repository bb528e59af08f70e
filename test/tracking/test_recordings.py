"""The real recordings: a slice of rolling clumps, and the diffusion of spheres in water."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from microbot_ros.cameras.source import open_source
from microbot_ros.tracking import Tracker, TrackerSettings, learn


def _fail(line: str) -> None:
    raise AssertionError(line)


def test_rolling_clumps_keep_their_names_and_debris_has_none(recordings: Path) -> None:
    source = open_source(recordings / 'mickyroll1.mp4', _fail)
    frames = list(itertools.islice(source.frames(), 100))
    settings = TrackerSettings()
    appearance = learn([frame.image for frame in frames[:10]], settings)
    assert appearance is not None
    assert not appearance.round
    tracker = Tracker(settings, appearance)
    names: set[int] = set()
    for frame in frames:
        poses = tracker.update(frame.image, frame.t)
        names.update(poses.id.tolist())
    # Counted by eye: nine clumps, all of them there from the first to the last of these frames.
    assert names == set(range(9))
    assert len(poses) == 9


def test_spheres_diffuse_as_stokes_and_einstein_say(recordings: Path) -> None:
    frames = list(open_source(recordings / 'bulk_water', _fail, 24.0).frames())[:40]
    settings = TrackerSettings()
    tracker = Tracker(settings, learn([frame.image for frame in frames[:10]], settings))
    places: dict[tuple[int, int], np.ndarray] = {}
    for frame in frames:
        poses = tracker.update(frame.image, frame.t)
        for name, place, seen in zip(poses.id, poses.xy, poses.seen, strict=True):
            if seen:
                places[frame.index, int(name)] = place / 2.85
    lags = np.arange(1, 13)
    squares = [
        np.mean([np.sum((places[t + lag, name] - place) ** 2) / 2
                 for (t, name), place in places.items() if (t + lag, name) in places])
        for lag in lags]
    assert 0.35 < np.polyfit(lags / 24, squares, 1)[0] / 2 < 0.50
