"""Rods have a front: the one that they go to, on the whole."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.tracking import Tracker, TrackerSettings
from microbot_ros.tracking.teach import teacher


def _rod(place: np.ndarray, angle: float, seed: int) -> np.ndarray:
    """A dark rod of 24 × 8 px at `place` (2,), along `angle`: (240, 240) uint8."""
    v, u = np.mgrid[:240, :240]
    along = (u - place[0]) * math.cos(angle) + (v - place[1]) * math.sin(angle)
    across = (v - place[1]) * math.cos(angle) - (u - place[0]) * math.sin(angle)
    beyond = np.hypot(np.maximum(np.abs(along) - 8, 0), across) - 4
    light = 150 + np.random.default_rng(seed).normal(0, 1.5, u.shape)
    return np.clip(np.rint(light - 70 / (1 + np.exp(1.6 * beyond))), 0, 255).astype(np.uint8)


def _headings(turn: float, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """True headings and those found (T,), of a rod that turns by `turn` [rad] a frame and swims by
    `speed` (T,) [px].
    """
    heading = 0.3 + turn * np.arange(len(speed))
    step = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    path = np.array([120.0, 120.0]) + np.cumsum(step, axis=0) - step.sum(axis=0) / 2
    frames = [_rod(place, angle, t) for t, (place, angle) in
              enumerate(zip(path, heading, strict=True))]
    settings, _ = teacher.like(TrackerSettings(), frames[0], *path[0])
    tracker, found = Tracker(settings), []
    for t, frame in enumerate(frames):
        poses = tracker.update(frame, t / 30)
        found.append(float(poses.theta_rad[0]) + math.pi if len(poses) else math.nan)
    return heading, np.array(found)


def _off(truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    return np.abs(np.angle(np.exp(1j * (found - truth))))


def test_the_front_of_a_rod_is_where_it_goes_all_around() -> None:
    truth, found = _headings(2 * math.pi / 60, np.full(90, 1.5))
    assert _off(truth, found)[40:].max() < 0.1


def test_the_front_goes_on_while_it_rests_or_is_pushed_back_a_little() -> None:
    speed = np.concatenate([np.full(60, 1.2), np.zeros(20), np.full(8, -1.2)])
    truth, found = _headings(2 * math.pi / 80, speed)
    assert _off(truth, found)[40:].max() < 0.1


def test_who_turns_back_for_good_has_its_front_there() -> None:
    speed = np.concatenate([np.full(25, 1.2), np.full(60, -1.2)])
    truth, found = _headings(0.0, speed)
    assert _off(truth + math.pi, found)[-5:].max() < 0.1
