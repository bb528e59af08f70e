"""Windows around the known particles must find what a search of the whole picture finds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench._tracker_scenes import KINDS, draw, expose, light
from microbot_ros.tracking import Appearance, Poses, Tracker, TrackerSettings, learn
from microbot_ros.tracking.link.states import PLACE, TrackStates, initiate_tracks
from microbot_ros.tracking.search_windows import SearchWindows, _apart
from microbot_ros.tracking.tracker import make_detector

_HEIGHT, _WIDTH = 300, 420
_NOWHERE = np.empty((0, 2))


def _swimmers(frames: int, seed: int = 4) -> list[np.ndarray]:
    """Six discs that swim, one of them only from frame 40 on; a flickering lamp."""
    rng = np.random.default_rng(seed)
    place = np.array(
        [[70, 60], [180, 80], [320, 70], [90, 220], [215, 225], [350, 210]], float)
    velocity = rng.normal(0, 0.8, place.shape)
    pictures = []
    for t in range(frames):
        picture = light(_HEIGHT, _WIDTH) * (1 + 0.03 * math.sin(t / 3))
        for k, at in enumerate(place + velocity * t):
            if k < 5 or t >= 40:
                draw(picture, at, KINDS['disc'], -60)
        pictures.append(expose(picture, 3.0, rng))
    return pictures


def _learned(pictures: list[np.ndarray], shape: str) -> tuple[TrackerSettings, Appearance]:
    chosen = TrackerSettings(shape=shape)
    appearance = learn(pictures[:6], chosen)
    assert appearance is not None
    return chosen, appearance


def _run(pictures: list[np.ndarray], shape: str, interval: float) -> list[Poses]:
    tracker = Tracker(*_learned(pictures, shape), full_search_interval=interval)
    return [tracker.update(picture, t / 60) for t, picture in enumerate(pictures)]


@pytest.mark.parametrize('shape', ['round', 'any'])
def test_windows_give_what_the_whole_picture_gives(shape: str) -> None:
    pictures = _swimmers(40)
    everywhere, windows = _run(pictures, shape, 0.0), _run(pictures, shape, 100.0)
    assert len(windows[-1]) == 5
    for one, other in zip(everywhere, windows, strict=True):
        np.testing.assert_array_equal(one.id, other.id)
        np.testing.assert_array_equal(one.seen, other.seen)
        np.testing.assert_allclose(one.xy, other.xy, atol=1e-3)
        np.testing.assert_allclose(one.velocity, other.velocity, atol=0.1)


@pytest.mark.parametrize('shape', ['round', 'any'])
def test_boxes_hold_what_the_whole_picture_holds_there(shape: str) -> None:
    pictures = _swimmers(8)
    chosen, appearance = _learned(pictures, shape)
    detector = make_detector(appearance, chosen)
    everything = detector.detect(pictures[6], _NOWHERE)
    grain = detector.grain_px
    box = np.array([[0, 120 // grain * grain, 160 // grain * grain, 270 // grain * grain]])
    part = detector.detect(pictures[6], _NOWHERE, box)
    inside = everything.xy[:, 0] >= box[0, 1]
    inside &= np.all(everything.xy < box[0, [3, 2]], axis=1)
    assert len(part) == np.sum(inside) == 1
    np.testing.assert_allclose(part.xy, everything.xy[inside], atol=1e-9)
    np.testing.assert_allclose(part.radius, everything.radius[inside], rtol=1e-6)


def test_a_new_particle_is_found_with_the_next_full_search() -> None:
    interval, pictures = 0.25, _swimmers(75)
    poses = _run(pictures, 'round', interval)
    found = next(t for t, pose in enumerate(poses) if len(pose) == 6)
    confirmed = TrackerSettings().confirm_frames - 1
    assert len(_run(pictures, 'round', 0.0)[40 + confirmed]) == 6
    assert 40 + confirmed < found <= 40 + interval * 60 + confirmed


def test_the_whole_picture_is_searched_at_once_when_it_jumps() -> None:
    pictures = _swimmers(40)
    moved = [np.roll(picture, (12, 35), (0, 1)) for picture in pictures[20:]]
    poses = _run([*pictures[:20], *moved], 'round', 100.0)
    np.testing.assert_array_equal(poses[19].id, poses[-1].id)
    assert all(np.all(pose.seen) for pose in poses[19:])
    np.testing.assert_allclose(poses[20].xy - poses[19].xy, [[35, 12]] * 5, atol=3)


def _states(count: int, **changes: np.ndarray) -> TrackStates:
    one = np.ones(count)
    states = initiate_tracks(
        np.linspace([100, 100], [300, 200], count), 0.1 * one, one, one, 5 * one,
        np.zeros(count, int), 1.0, 0.0, 2)
    states.id = np.arange(count)
    for name, value in changes.items():
        setattr(states, name, value)
    return states


def test_windows_are_for_settled_particles_and_for_a_while() -> None:
    search_windows, size = SearchWindows(1.0, 10.0, 15.0, 2), (_HEIGHT, _WIDTH)
    assert search_windows.windows(0.0, _states(3), size) is None
    search_windows.looked_everywhere(5.0)
    boxes = search_windows.windows(5.5, _states(3), size)
    assert boxes is not None
    np.testing.assert_array_equal(boxes[0], [70, 70, 130, 130])
    assert np.all(boxes % 2 == 0)
    assert search_windows.windows(6.0, _states(3), size) is None
    assert search_windows.windows(4.9, _states(3), size) is None
    assert search_windows.windows(5.5, _states(0), size) is None
    for state in ({'id': np.array([0, -1])}, {'missed': np.array([0, 1])},
                  {'host': np.array([1, -1])}):
        assert search_windows.windows(5.5, _states(2, **state), size) is None
    assert search_windows.windows(5.5, _states(60), size) is None
    assert search_windows.windows(math.nan, _states(3), size) is None
    gone = _states(3)
    gone.motion[1, PLACE] = _WIDTH + 100 + 50j
    assert search_windows.windows(5.5, gone, size) is None
    gone.motion[1, PLACE] = complex(math.nan, 50)
    assert search_windows.windows(5.5, gone, size) is None


@pytest.mark.parametrize('shape', ['round', 'any'])
def test_who_leaves_at_high_speed_is_let_go(shape: str) -> None:
    """Its window would lie outside the picture, or be a sliver at its edge."""
    rng = np.random.default_rng(9)
    pictures = []
    for t in range(75):
        picture = light(_HEIGHT, _WIDTH)
        for at in ([100, 90], [110, 210], [40 + 9.3 * max(t - 6, 0), 150]):
            draw(picture, np.array(at, float), KINDS['disc'], -60)
        pictures.append(expose(picture, 3.0, rng))
    poses = _run(pictures, shape, 100.0)
    assert len(poses[20]) == len(poses[40]) == 3
    stay = poses[20].y_px.round() != 150
    np.testing.assert_array_equal(poses[-1].id, poses[20].id[stay])


@settings(max_examples=60)
@given(st.lists(st.tuples(*[st.integers(0, 40)] * 2, *[st.integers(1, 15)] * 2), min_size=1,
                max_size=12))
def test_boxes_that_meet_become_one(corners: list[tuple[int, int, int, int]]) -> None:
    boxes = np.array([[y, x, y + h, x + w] for y, x, h, w in corners])
    apart = _apart(boxes.copy())
    covered = np.zeros((60, 60), int)
    for y0, x0, y1, x1 in apart:
        covered[y0:y1, x0:x1] += 1
    assert covered.max() == 1
    for y0, x0, y1, x1 in boxes:
        assert np.all(covered[y0:y1, x0:x1] == 1)
