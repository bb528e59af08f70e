"""Pixels of the camera that are not square."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effects.field.coil_gain_mismatch import CoilGainMismatch
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class PixelAnisotropy(Effect):
    """Measured = diag(1, a) true.

    Bounds of a: wide-screen video pixels are 1.46 times as wide as high (ITU-R BT.601), and no
    camera exceeds that. Motion that is anisotropic for another reason, as of rollers whose speed
    fluctuates along one line, would exceed them. One field of an interlaced image, half the rows,
    is outside too: it is visible in the film.
    """

    id = 'pixel_anisotropy'
    stage = 'observation'
    summary = 'The image is stretched along one axis.'
    required_excitation = 'commands in all directions'
    confounded_with = ('coil_gain_mismatch',)

    aspect: float = parameter('aspect', 'y over x', 1 / 1.5, 1.5, 0.1, null_value=1.0)

    def observe(self, position: np.ndarray) -> np.ndarray:
        return position * np.array([1.0, self.aspect])

    def true_position(self, observed: np.ndarray) -> np.ndarray:
        return observed / np.array([1.0, self.aspect])

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        """Return whether the commands turn far enough.

        Along one line, speeds absorb the effect. Within about 9° of a line less than 5 % of its
        information remains, and it bends paths as unequal coils do; cameras are squarer than coils
        are equal.
        """
        return not evidence.absorbs(cls(1.01), beside=[CoilGainMismatch(1.01)])
