"""Two that touch and turn are still two: each keeps its name, its place and its heading."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.tracking import Poses, Tracker, TrackerSettings
from microbot_ros.tracking.locate.bodies import find_bodies
from microbot_ros.tracking.teach import teacher

_V, _U = np.mgrid[:200, :200]
_APART, _TOUCHING = 25, slice(25, 75)
"""Frames in which the two come near, and in which they touch."""

_Shape = tuple[float, float, float, float]
"""Length of the axis and radius [px], and the angles of both to the line between them [rad]."""

_ACROSS = math.pi / 2
_DISCS, _IN_LINE = (0.0, 8.0, 0.0, 0.0), (24.0, 5.0, 0.0, 0.0)
_LIKE_A_T, _SIDE_BY_SIDE = (24.0, 5.0, 0.0, _ACROSS), (24.0, 5.0, _ACROSS, _ACROSS)


def _rod(x: float, y: float, angle: float, length: float, radius: float) -> np.ndarray:
    """How much of each pixel is covered by a rod with round ends, or by a disc."""
    along = (_U - x) * math.cos(angle) + (_V - y) * math.sin(angle)
    along = np.clip(along, -length / 2, length / 2)
    away = np.hypot(_U - x - along * math.cos(angle), _V - y - along * math.sin(angle))
    return np.asarray(1 / (1 + np.exp(away - radius)))


def _turning(shape: _Shape, gap: float, degrees: float, seed: int
             ) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Pictures, places (100, 2, 2) [px] and axes (100, 2) [rad] of two that come near, turn as one
    by so many `degrees` a frame with a `gap` [px] between them, and part.
    """
    rng = np.random.default_rng(seed)
    length, radius, first, second = shape
    t = np.arange(100)
    turned = rng.uniform(0, math.tau) + math.radians(degrees) * np.clip(t - 25, 0, 50)
    near = 2 * radius + gap + length / 2 * (math.cos(first) + math.cos(second))
    apart = near + 1.2 * (np.maximum(25 - t, 0) + np.maximum(t - 75, 0))
    half = apart[:, None] / 2 * np.column_stack([np.cos(turned), np.sin(turned)])
    places = 100 + np.stack([-half, half], axis=1)
    axes = np.column_stack([turned + first, turned + second])
    pictures = []
    for k in t:
        covered = np.maximum(*(_rod(*places[k, n], axes[k, n], length, radius) for n in (0, 1)))
        light = 150 - 90 * covered + rng.normal(0, 1.5, covered.shape)
        pictures.append(np.clip(np.rint(light), 0, 255).astype(np.uint8))
    return pictures, places, axes


def _nearest(poses: Poses, places: np.ndarray) -> list[int]:
    away = np.linalg.norm(poses.xy[:, None] - places, axis=2)
    return [int(name) for name in poses.id[np.argmin(away, axis=0)]]


@pytest.mark.parametrize('degrees', [2.0, 5.0])
@pytest.mark.parametrize(('shape', 'gap'), [
    (_DISCS, 1.0), (_DISCS, 0.0), (_IN_LINE, 1.0), (_IN_LINE, 0.0), (_LIKE_A_T, 0.0),
    (_LIKE_A_T, -1.0), (_SIDE_BY_SIDE, 2.0), (_SIDE_BY_SIDE, 1.0)])
def test_two_that_touch_and_turn_keep_their_names_places_and_headings(
    shape: _Shape, gap: float, degrees: float
) -> None:
    pictures, places, axes = _turning(shape, gap, degrees, 3)
    learned, _ = teacher.like(TrackerSettings(), pictures[0], *places[0, 0])
    tracker = Tracker(learned)
    poses = [tracker.update(picture, k / 10) for k, picture in enumerate(pictures)]
    names = _nearest(poses[_APART - 5], places[_APART - 5])
    assert len(set(names)) == 2
    touching = zip(poses[_TOUCHING], places[_TOUCHING], axes[_TOUCHING], strict=True)
    for now, place, axis in touching:
        assert now.id[now.seen].tolist() == sorted(names)
        rows = [now.id.tolist().index(name) for name in names]
        assert np.linalg.norm(now.xy[rows] - place, axis=1).max() < 0.6
        if shape[0]:
            off = np.mod(now.theta_rad[rows] - axis + math.pi / 2, math.pi) - math.pi / 2
            assert np.abs(off).max() < math.radians(5)
    assert _nearest(poses[-1], places[-1]) == names


@settings(max_examples=40)
@given(st.floats(7, 12), st.floats(7, 12), st.floats(0, math.tau), st.floats(-1, 1),
       st.integers(0, 99))
def test_parts_make_up_the_whole_and_one_is_never_parted(
    first: float, second: float, angle: float, gap: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    half = (first + second + gap) / 2 * np.array([math.cos(angle), math.sin(angle)])
    covered = np.maximum(_rod(*(100 - half), 0, 0, first), _rod(*(100 + half), 0, 0, second))
    image = 150 - 90 * covered + rng.normal(0, 1, covered.shape)
    one = find_bodies(image, True, 40.0, 1, 80.0)
    two = find_bodies(image, True, 40.0, 1, 80.0, known=100 + np.array([-half, half]))
    assert (len(one), len(two)) == (1, 2)
    assert np.sum(two.width**2) == pytest.approx(one.width[0] ** 2)
    same = find_bodies(image, True, 40.0, 1, 80.0, known=np.array([100 + half, 100 + half]))
    assert len(same) == 1
    order = np.argmin(np.linalg.norm(two.xy[:, None] - (100 + np.array([-half, half])), axis=2),
                      axis=0)
    assert sorted(order) == [0, 1]
    np.testing.assert_allclose(two.width[order], [2 * first, 2 * second], rtol=0.1)


def test_a_body_without_a_neck_is_one_though_two_are_known_in_it() -> None:
    noise = np.random.default_rng(1).normal(0, 1, (200, 200))
    image = 150 - 90 * _rod(100, 100, 0.3, 30, 8) + noise
    found = find_bodies(image, True, 40.0, 1, 80.0, known=np.array([[90.0, 97.0], [110.0, 103.0]]))
    assert len(found) == 1
