"""The one transform between image and workspace."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from microbot_ros.common import units


@dataclass(frozen=True)
class ImageToWorkspace:
    """Transform between pixels and metres, also for angles and vectors.

    Image: x right, y down, the centre of the first pixel at (0, 0); image angles turn from x
    towards y, clockwise on the screen. Workspace: x along the x coils, y up, the origin at the
    centre of the image; angles counter-clockwise.

    Attributes
    ----------
    pixel_size : float [m]
    width, height : int [px]
    rotation : float
        Workspace angle of the image's x axis [rad].
    mirrored : bool
        Whether the optics mirror the picture, so that image y points along workspace y.
    """

    pixel_size: float
    width: int
    height: int
    rotation: float = 0.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        if not (0 < self.pixel_size < math.inf and math.isfinite(self.rotation)):
            raise ValueError(
                'pixel_size must be positive and rotation finite; received '
                f'{self.pixel_size} m, {self.rotation} rad'
            )
        if not (self.width > 0 and self.height > 0):
            raise ValueError(
                f'the image must have pixels; received {self.width}×{self.height}'
            )

    @classmethod
    def of_tracker(cls, parameters: Mapping[str, Any], width: int, height: int) -> Self:
        """Return the transform stated by the `parameters` of a tracker; `width`, `height` [px].

        Raises KeyError for one that is missing and ValueError for one that is no number.

        Parameters
        ----------
        parameters : mapping of str to object
            Parameters by name.
        width : int
            Width of the picture [px].
        height : int
            Height of the picture [px].

        Returns
        -------
        Self
            The transform.
        """
        return cls(units.to_si('pixel_size_um', float(parameters['pixel_size_um'])), width, height,
                   units.to_si('rotation_deg', float(parameters['rotation_deg'])),
                   bool(parameters['mirrored']))

    @cached_property
    def _centre(self) -> np.ndarray:
        return np.array([(self.width - 1) / 2, (self.height - 1) / 2])

    @cached_property
    def _matrix(self) -> np.ndarray:
        """Metres per pixel: the y flip first, then the rotation."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        flip = 1.0 if self.mirrored else -1.0
        return self.pixel_size * np.array([[c, -s * flip], [s, c * flip]])

    @cached_property
    def _inverse(self) -> np.ndarray:
        """Pixels per metre."""
        return np.linalg.inv(self._matrix)

    def position(self, pixels: np.ndarray) -> np.ndarray:
        """Convert image points `pixels` (..., 2) [px] to workspace positions [m].

        Parameters
        ----------
        pixels : ndarray, shape (..., 2)
            Image points [px].

        Returns
        -------
        ndarray, shape (..., 2)
            Positions [m].
        """
        return (np.asarray(pixels, float) - self._centre) @ self._matrix.T

    def pixels(self, position: np.ndarray) -> np.ndarray:
        """Convert workspace positions (..., 2) [m] to image points [px].

        Parameters
        ----------
        position : ndarray, shape (..., 2)
            Positions [m].

        Returns
        -------
        ndarray, shape (..., 2)
            Image points [px].
        """
        return np.asarray(position, float) @ self._inverse.T + self._centre

    def vector(self, pixels: np.ndarray) -> np.ndarray:
        """Convert displacements or velocities `pixels` (..., 2) [px, px/s] to [m, m/s].

        Parameters
        ----------
        pixels : ndarray, shape (..., 2)
            Displacements [px] or velocities [px/s].

        Returns
        -------
        ndarray, shape (..., 2)
            Displacements [m] or velocities [m/s].
        """
        return np.asarray(pixels, float) @ self._matrix.T

    def vector_pixels(self, vector: np.ndarray) -> np.ndarray:
        """Convert a `vector` (..., 2) [m, m/s] to [px, px/s].

        Parameters
        ----------
        vector : ndarray, shape (..., 2)
            Displacements [m] or velocities [m/s].

        Returns
        -------
        ndarray, shape (..., 2)
            Displacements [px] or velocities [px/s].
        """
        return np.asarray(vector, float) @ self._inverse.T

    def image_axes(self, vector: np.ndarray) -> np.ndarray:
        """Rotate a workspace `vector` (..., 2) into image axes, keeping its length.

        Parameters
        ----------
        vector : ndarray, shape (..., 2)
            Vectors in the workspace.

        Returns
        -------
        ndarray, shape (..., 2)
            Vectors in the axes of the image.
        """
        return self.vector_pixels(vector) * self.pixel_size

    def angle(self, image_angle: np.ndarray) -> np.ndarray:
        """Convert an `image_angle` [rad] to workspace angles in (−π, π]; NaN stays NaN.

        Parameters
        ----------
        image_angle : ndarray
            Angles in the image, of any shape [rad].

        Returns
        -------
        ndarray
            Angles in the workspace [rad], of the same shape.
        """
        return _wrapped(self.rotation + self._sense * np.asarray(image_angle, float))

    def image_angle(self, angle: np.ndarray) -> np.ndarray:
        """Convert a workspace `angle` [rad] to image angles in (−π, π]; NaN stays NaN.

        Parameters
        ----------
        angle : ndarray
            Angles in the workspace, of any shape [rad].

        Returns
        -------
        ndarray
            Angles in the image [rad], of the same shape.
        """
        return _wrapped(self._sense * (np.asarray(angle, float) - self.rotation))

    @property
    def _sense(self) -> float:
        return 1.0 if self.mirrored else -1.0


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)
