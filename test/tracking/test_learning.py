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


def _strange(kind: str, rng: np.random.Generator) -> np.ndarray:
    """A picture (120, 160) without any particle in it."""
    y, x = np.mgrid[0:120, 0:160].astype(float)
    if kind == 'waves':
        return 128 + 100 * np.sin(x / rng.uniform(1, 20)) * np.sin(y / rng.uniform(1, 20))
    if kind == 'one large disc':
        return 200.0 * (np.hypot(x - rng.uniform(0, 160), y - 60) < rng.uniform(2, 60))
    if kind == 'slope':
        return x * rng.uniform(0, 0.8) + y * rng.uniform(0, 0.8)
    if kind == 'hot pixels':
        return np.where(rng.random(x.shape) < 0.002, 255.0, 150.0)
    if kind == 'tiles':
        return 255.0 * ((x // rng.integers(2, 30) + y // rng.integers(2, 30)) % 2)
    return np.where(x == rng.integers(0, 160), 0.0, 150.0)


@pytest.mark.parametrize('kind', [
    'waves', 'one large disc', 'slope', 'hot pixels', 'tiles', 'a dead column'])
def test_whatever_the_picture_shows_it_does_not_break_the_tracker(kind: str) -> None:
    rng = np.random.default_rng(1)
    for noise in (0.0, 0.5, 3.0, 0.0):
        frames = [
            np.clip(_strange(kind, rng) + rng.normal(0, noise, (120, 160)), 0, 255).astype('u1')
            for _ in range(3)]
        appearance = learn(frames, TrackerSettings())
        assert appearance is None or appearance.diameter_px > 2.4
        if appearance is not None:
            detector = make_detector(appearance, TrackerSettings())
            for frame in frames:
                found = detector.detect(frame, np.array([[5.0, 5.0], [80.0, 60.0]]))
                assert np.isfinite(found.xy).all()
                assert (found.sigma > 0).all()
        if kind in ('slope', 'hot pixels'):
            assert appearance is None
