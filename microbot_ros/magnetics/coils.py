"""The rig's four coils: field and gradient of any set of currents, linear in each."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.magnetics.settings import CoilSettings
from microbot_ros.magnetics.sources import as_points


class CoilSet:
    """Coils from settings, in SI; arrays over coils are in the order of `names`.

    Points are (M, 3) [m] in the workspace frame, or (M, 2) in its plane z = 0. Fields are those
    of the currents alone; `background` is not in them. On a wire they are NaN.
    """

    def __init__(self, settings: CoilSettings | None = None) -> None:
        settings = settings or CoilSettings()
        windings = settings.windings
        self.names = tuple(winding.name for winding in windings)
        self.resistance = np.array([winding.resistance_ohm for winding in windings])
        """(4,) [Ω]."""
        self.max_current = np.array([winding.max_current_A for winding in windings])
        """(4,) [A], either way."""
        self.background = 1e-3 * np.array(settings.background_mT)
        """In-plane field (2,) [T] that is there without current."""
        self._sources = [winding.source() for winding in windings]

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Field of each coil [T/A]: (4, M, 3)."""
        points = as_points(points)
        return np.stack([source.field_per_ampere(points) for source in self._sources])

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Gradient of each coil, `[..., i, j]` = ∂Bᵢ/∂xⱼ [T/m/A]: (4, M, 3, 3)."""
        points = as_points(points)
        return np.stack([source.gradient_per_ampere(points) for source in self._sources])

    def field(self, currents: ArrayLike, points: ArrayLike) -> np.ndarray:
        """Field [T] of currents (4,) [A]: (M, 3)."""
        return np.tensordot(np.asarray(currents), self.field_per_ampere(points), 1)

    def gradient(self, currents: ArrayLike, points: ArrayLike) -> np.ndarray:
        """Gradient ∂Bᵢ/∂xⱼ [T/m] of currents (4,) [A]: (M, 3, 3)."""
        return np.tensordot(np.asarray(currents), self.gradient_per_ampere(points), 1)

    def actuation_matrix(self, point: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Field at one point per ampere in each coil [T/A]: (3, 4)."""
        return self.field_per_ampere(np.reshape(point, (1, -1)))[:, 0].T

    def power(self, currents: ArrayLike) -> float:
        """Heat in the windings [W] under currents (4,) [A]."""
        return float(np.square(currents) @ self.resistance)
