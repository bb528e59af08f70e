"""The direction of the cap, on spheres drawn here: half a disc darker than the other half."""

from __future__ import annotations

import numpy as np

from bench._tracker_scenes import expose, light
from microbot_ros.tracking import TrackerSettings, learn
from microbot_ros.tracking.tracker import make_detector

NOWHERE = np.empty((0, 2))


def _spheres(cap: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A frame of 24 discs, their centres [px] and cap directions [rad, towards y down]."""
    x, y = np.meshgrid(np.arange(30, 320, 48), np.arange(30, 220, 48))
    centres = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-4, 4, (x.size, 2))
    theta = rng.uniform(-np.pi, np.pi, len(centres))
    fine = (np.arange(-40, 41)) / 4
    picture = np.repeat(np.repeat(light(240, 336), 4, axis=0), 4, axis=1)
    for (cx, cy), angle in zip(centres, theta, strict=True):
        column, row = round(4 * cx + 1.5), round(4 * cy + 1.5)
        u, v = np.meshgrid(fine + (column - 1.5) / 4 - cx, fine + (row - 1.5) / 4 - cy)
        edge = 0.5 * (1 - np.tanh((np.hypot(u, v) - 5) / 0.8))
        side = 0.5 * (1 + np.tanh((u * np.cos(angle) + v * np.sin(angle)) / 0.8))
        picture[row - 40:row + 41, column - 40:column + 41] -= edge * (40 + cap * side)
    coarse = picture.reshape(240, 4, 336, 4).mean(axis=(1, 3))
    return expose(coarse, 3, rng), centres, theta


def test_the_cap_is_found_and_the_centre_stays_the_sphere_s() -> None:
    rng = np.random.default_rng(1)
    views = [_spheres(50, rng) for _ in range(6)]
    settings = TrackerSettings(shape='round')
    appearance = learn([view[0] for view in views], settings)
    assert appearance is not None
    assert appearance.capped
    detector = make_detector(appearance, settings)
    turns, along, across = [], [], []
    for frame, centres, theta in views:
        found = detector.detect(frame, NOWHERE)
        which = np.argmin(np.linalg.norm(found.xy[:, None] - centres, axis=2), axis=1)
        assert len(set(which)) == len(centres) == len(found)
        turns.append(np.angle(np.exp(1j * (found.theta - theta[which]))))
        offset, angle = found.xy - centres[which], theta[which]
        along.append(offset[:, 0] * np.cos(angle) + offset[:, 1] * np.sin(angle))
        across.append(offset[:, 1] * np.cos(angle) - offset[:, 0] * np.sin(angle))
    assert np.isfinite(turns).all()
    assert np.max(np.abs(turns)) < 0.2
    assert abs(np.mean(turns)) < 0.01
    assert abs(np.mean(across)) < 0.02
    assert abs(np.mean(along)) < 0.1


def test_a_bright_cap_is_the_other_side() -> None:
    rng = np.random.default_rng(1)
    views = [_spheres(50, rng) for _ in range(3)]
    settings = TrackerSettings(shape='round', cap='bright')
    appearance = learn([view[0] for view in views], settings)
    assert appearance is not None
    found = make_detector(appearance, settings).detect(views[0][0], NOWHERE)
    which = np.argmin(np.linalg.norm(found.xy[:, None] - views[0][1], axis=2), axis=1)
    assert np.cos(found.theta - views[0][2][which]).max() < -0.9


def test_plain_spheres_have_no_direction() -> None:
    rng = np.random.default_rng(3)
    views = [_spheres(0, rng) for _ in range(3)]
    settings = TrackerSettings(shape='round')
    appearance = learn([view[0] for view in views], settings)
    assert appearance is not None
    assert not appearance.capped
    assert np.isnan(make_detector(appearance, settings).detect(views[0][0], NOWHERE).theta).all()
