"""What a page is told of how the camera lies is what the tracker itself goes by."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.nodes.client.rig_view import _to_um
from microbot_ros.tracking.camera import ImageToWorkspace


@pytest.mark.parametrize('mirrored', [False, True])
@pytest.mark.parametrize('rotation', [0.0, 0.3, -np.pi / 2])
def test_rows_for_the_page_are_the_tracker_s_map(rotation, mirrored):
    camera = ImageToWorkspace(0.4e-6, 640, 480, rotation, mirrored)
    pixels = np.array([[0.0, 0.0], [639, 0], [12.5, 400.25]])
    rows = np.array(_to_um(camera))
    np.testing.assert_allclose(
        pixels @ rows[:, :2].T + rows[:, 2], 1e6 * camera.position(pixels), atol=1e-6)
