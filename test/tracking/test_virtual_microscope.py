"""The tracker on the virtual rig's own pictures, as in the demo: learned from the first frames.

A handful of Janus spheres of 10 px among specks, smudges and out-of-focus debris, none of which
is to be tracked; the cap trails the heading.
"""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.tracking import ImageToWorkspace, Tracker, TrackerSettings
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings


def test_the_demo_s_particles_are_found_with_their_caps_and_nothing_else() -> None:
    view = MicroscopeSettings()
    scope = Microscope(view, seed=1)
    camera = ImageToWorkspace(view.pixel_size, view.width_px, view.height_px)
    tracker = Tracker(TrackerSettings())
    rng = np.random.default_rng(2)
    place = np.array([[-80.0, 20.0], [10.0, 0.0], [80.0, -30.0], [50.0, 60.0]]) * 1e-6
    heading = np.array([0.3, 1.0, 2.0, 3.0])
    errors, turns, counts = [], [], []
    for frame in range(200):
        swim = 4e-6 / 60 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        place = place + swim + rng.normal(0, np.sqrt(2 * 0.076e-12 / 60), place.shape)
        poses = tracker.update(scope.render(place, heading, frame / 60), frame / 60)
        if frame < 60:
            continue
        counts.append(len(poses))
        found = camera.position(poses.xy)
        distance = np.hypot(*(found[:, None] - place).transpose(2, 0, 1))
        nearest = distance.argmin(1)
        errors += distance.min(1).tolist()
        turns += np.angle(np.exp(1j * (
            camera.angle(poses.theta_rad) + np.pi - heading[nearest]))).tolist()
    assert set(counts) == {4}
    assert np.max(errors) < 0.5e-6
    assert np.nanmax(np.abs(turns)) < 0.3
    assert np.isfinite(turns).mean() > 0.9


@pytest.mark.parametrize('apart_um', [9.0, 7.0, 5.5])
def test_particles_side_by_side_are_both_seen(apart_um: float) -> None:
    """Until its cap is found a neighbour must not spoil the fit of the other."""
    view = MicroscopeSettings()
    scope = Microscope(view, seed=1)
    camera = ImageToWorkspace(view.pixel_size, view.width_px, view.height_px)
    tracker = Tracker(TrackerSettings())
    heading = np.array([0.3, 1.0, 2.0, 3.0])
    place = np.array([[-40.0, -40.0], [40.0, -40.0], [40.0, 60.0], [-80.0, 60.0]]) * 1e-6
    frame = 0
    while not tracker.ready:
        tracker.update(scope.render(place, heading, frame / 60), frame / 60)
        frame += 1
        assert frame < 200
    place[1] = place[0] + apart_um * 1e-6 * np.array([np.cos(0.5), np.sin(0.5)])
    for _ in range(10):
        poses = tracker.update(scope.render(place, heading, frame / 60), frame / 60)
        frame += 1
    found = camera.position(poses.xy)
    nearest = np.hypot(*(found[:, None] - place).transpose(2, 0, 1)).argmin(1)
    assert sorted(nearest.tolist()) == [0, 1, 2, 3]
