"""A film of three particles that rest."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

PLACE = np.array([[-60.0, 20.0], [10.0, -40.0], [70.0, 30.0]]) * 1e-6
HEADING = np.array([0.3, 1.0, 2.0])


def film(folder: Path, frames: int) -> Path:
    """The new `folder` with so many pictures of them."""
    folder.mkdir()
    scope = Microscope(MicroscopeSettings(), seed=3)
    for frame in range(frames):
        cv2.imwrite(str(folder / f'{frame:03d}.png'), scope.render(PLACE, HEADING, frame / 30))
    return folder
