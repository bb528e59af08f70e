"""The tracker on the virtual rig's own pictures: Janus spheres of 10 px side by side."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.tracking import ImageToWorkspace, Tracker, TrackerSettings
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings


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
