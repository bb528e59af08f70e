"""What the tracker learns by itself on random microscopes: the spheres, not the debris."""

from __future__ import annotations

import numpy as np
import pytest

from bench._tracker_worlds import LEARNING, world
from microbot_ros.tracking import TrackerSettings, learn
from microbot_ros.tracking.tracker import make_detector


@pytest.mark.parametrize('seed', [
    pytest.param(15, id='bright rings'), pytest.param(22, id='dark rings'),
    pytest.param(12, id='small, among many specks'), pytest.param(6, id='wide, faint caps'),
    pytest.param(16, id='bright caps'), pytest.param(19, id='three, wide')])
def test_the_spheres_are_learned_and_the_debris_is_not(seed: int) -> None:
    seen = world(seed, 5)
    settings = TrackerSettings(cap='bright' if seen.bright else 'dark')
    appearance = learn(seen.frames[:LEARNING], settings)
    assert appearance is not None
    assert appearance.dark is not seen.bright
    assert 1.7 < appearance.diameter_px / seen.radius_px < 2.6
    detector = make_detector(appearance, settings)
    views = list(zip(seen.frames, seen.places, seen.caps, strict=True))[LEARNING:]
    for frame, places, caps in views:
        found = detector.detect(frame, np.empty((0, 2)))
        offset = found.xy[:, None] - places
        which = np.argmin(np.linalg.norm(offset, axis=2), axis=1)
        assert sorted(which) == list(range(len(places)))
        assert np.abs(offset[np.arange(len(which)), which]).max() < 0.2
        if appearance.capped:
            assert np.cos(found.theta - caps[which]).min() > 0.98
