"""Each thing that can be wrong with a picture is said, and nothing where all is well."""

from __future__ import annotations

import numpy as np
import pytest

from bench._tracker_scenes import expose, light
from microbot_ros.tracking import Tracker, TrackerSettings
from microbot_ros.tracking.frame_quality import FrameQuality

_LAMP = light(120, 160)


def _frame(level: float, seed: int = 0) -> np.ndarray:
    return expose(level * _LAMP, 4.0, np.random.default_rng(seed))


def _after(frames: int = 40) -> FrameQuality:
    quality = FrameQuality()
    for k in range(frames):
        assert quality.look(_frame(1.0, k), 0.02 if k else None, 0.0) == {}
    return quality


def test_a_lamp_that_is_steady_or_drifts_a_little_is_passed_over() -> None:
    quality = _after()
    for k in range(100):
        assert quality.look(_frame(1 - 0.002 * k), 0.02, 0.0) == {}


@pytest.mark.parametrize('level', [0.8, 1.2])
def test_a_flicker_is_said_in_the_frame_that_has_it(level: float) -> None:
    quality = _after()
    assert list(quality.look(_frame(level), 0.02, 0.0)) == ['flicker']
    assert quality.look(_frame(1.0), 0.02, 0.0) == {}


def test_a_drift_is_said_once_it_is_large() -> None:
    quality = _after()
    said = [quality.look(_frame(1 - 0.004 * k), 0.02, 0.0) for k in range(120)]
    assert said[40] == {}
    assert list(said[-1]) == ['drift']
    assert 'differs by' in said[-1]['drift']


def test_saturated_and_blank_pictures_are_said() -> None:
    quality = _after()
    bright = _frame(1.0)
    bright[:12] = 255
    assert quality.look(bright, 0.02, 0.0) == {'saturated': '10 % of the image is saturated'}
    for value in (0, 7, 255):
        assert 'blank' in _after().look(np.full((120, 160), value, np.uint8), 0.02, 0.0)
    deep = np.full((120, 160), 65535, np.uint16)
    assert 'saturated' in FrameQuality().look(deep, None, 0.0)


@pytest.mark.parametrize(('dt', 'expected'), [(0.04, []), (0.06, ['late']), (1.0, ['late'])])
def test_a_late_frame_is_said(dt: float, expected: list[str]) -> None:
    assert list(_after().look(_frame(1.0), dt, 0.0)) == expected


def test_the_tracker_tells_it_of_its_last_frame() -> None:
    tracker = Tracker(TrackerSettings())
    for k in range(20):
        tracker.update(_frame(1.0, k), k / 50)
    assert tracker.remarks == {}
    tracker.update(_frame(1.0, 20), 1.0)
    assert list(tracker.remarks) == ['late']
    tracker.update(_frame(1.0, 21), 1.02)
    assert tracker.remarks == {}


def test_a_small_picture_is_left_as_it_is() -> None:
    picture = np.random.default_rng(0).integers(0, 255, (60, 200), np.uint8)
    before = picture.copy()
    FrameQuality().look(picture, None, 0.0)
    np.testing.assert_array_equal(picture, before)
