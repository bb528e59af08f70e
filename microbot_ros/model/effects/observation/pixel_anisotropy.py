"""The camera’s pixels are not square."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effects.field.coil_gain_mismatch import CoilGainMismatch
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class PixelAnisotropy(Effect):
    """measured = diag(1, a) true.

    Bounds of a: wide-screen video pixels are 1.46 as wide as high (ITU-R BT.601); no camera goes
    beyond. Motion that is not isotropic for another reason, as of rollers whose speed fluctuates
    along one line, would exceed them. One field of an interlaced picture, half the rows, is not in
    them: it shows in the film.
    """

    id = 'pixel_anisotropy'
    stage = 'observation'
    summary = 'The picture is stretched along one axis.'
    required_excitation = 'commands in all directions'
    confounded_with = ('coil_gain_mismatch',)

    aspect: float = parameter('aspect', 'y over x', 1 / 1.5, 1.5, 0.1, null_value=1.0)

    def observe(self, position: np.ndarray) -> np.ndarray:
        return position * np.array([1.0, self.aspect])

    def true_position(self, observed: np.ndarray) -> np.ndarray:
        return observed / np.array([1.0, self.aspect])

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        """Whether commands turn far enough.

        Along one line, speeds absorb it. Within some 9° of a line less than 5 % of its information
        is left, and it bends paths as unlike coils do; cameras are squarer than coils are alike.
        """
        return not evidence.absorbs(cls(1.01), beside=[CoilGainMismatch(1.01)])
