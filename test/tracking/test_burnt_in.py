"""What is burnt into the pictures of a live camera is left out; who rests is not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from microbot_ros.loop.tracker import TrackerParameters, TrackerStage

_RESTS, _LETTER = (60.0, 60.0), (230.0, 160.0)


def _frame(t: int, noise: float) -> np.ndarray:
    """One swims, one rests, and there is an O, written after the exposure: (200, 300) uint8."""
    v, u = np.mgrid[:200, :300]
    light = 150 + np.random.default_rng(t).normal(0, noise, u.shape)
    for x, y in ((80.0 + 2 * t, 120.0), _RESTS):
        light -= 90 / (1 + np.exp(1.6 * (np.hypot(u - x, v - y) - 6)))
    picture = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    cv2.circle(picture, (int(_LETTER[0]), int(_LETTER[1])), 6, 55, -1, cv2.LINE_AA)
    return picture


def _stage(noise: float, frames: int = 12) -> TrackerStage:
    stage = TrackerStage(TrackerParameters())
    for t in range(frames):
        stage.step(_frame(t, noise), 0.1 * t)
    return stage


def _followed(stage: TrackerStage, noise: float) -> list[tuple[int, int]]:
    for t in range(12, 20):
        stage.step(_frame(t, noise), 0.1 * t)
    assert stage.poses is not None
    places = stage.poses.xy.tolist()
    places.sort()
    return [(round(x), round(y)) for x, y in places]


def test_what_is_burnt_in_is_left_out_and_who_rests_is_followed() -> None:
    stage = _stage(3.0)
    assert stage.teach(True, 102, 120).endswith('burnt into the picture: what is at 230,160')
    assert _followed(stage, 3.0) == [(60, 60), (118, 120)]


@pytest.mark.parametrize(('noise', 'frames'), [(0.0, 12), (3.0, 5)])
def test_where_no_noise_tells_nothing_is_left_out(noise: float, frames: int) -> None:
    stage = _stage(noise, frames)
    assert 'left out' not in stage.teach(True, 80 + 2 * (frames - 1), 120)
    assert len(_followed(stage, noise)) == 3


def test_who_points_at_what_was_left_out_wants_it_followed() -> None:
    stage = _stage(3.0)
    stage.teach(True, 102, 120)
    assert 'left out' not in stage.teach(True, 230, 160)
    assert len(_followed(stage, 3.0)) == 3
