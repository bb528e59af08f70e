"""The rig's coils: field and gradient of any set of currents."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.magnetics.settings import CoilSettings
from microbot_ros.magnetics.sources import as_points

# Coils whose weakest direction of field, all at their limits, is below this part of their
# strongest are not meant for three axes: four coils in a plane, not placed perfectly, reach 0.1.
_MEANT = 0.2


class CoilSet:
    """N coils from settings, in SI; arrays over coils are in the order of `names`.

    Points are (M, 3) [m] in the workspace frame, or (M, 2) in its plane z = 0. Fields are those
    of the currents alone; `background` is not in them. On a wire they are NaN. Coils whose core
    saturates make the field of an `effective` current; per ampere means per effective ampere.
    """

    def __init__(self, settings: CoilSettings | None = None) -> None:
        settings = settings or CoilSettings()
        windings = settings.windings
        self.names = tuple(winding.name for winding in windings)
        self.resistance = np.array([winding.resistance_ohm for winding in windings])
        """(N,) [Ω]."""
        self.max_current = np.array([winding.max_current_A for winding in windings])
        """(N,) [A], either way."""
        self._sources = [winding.made_by() for winding in windings]
        self._curves = {k: winding.curve() for k, winding in enumerate(windings)
                        if winding.saturation is not None}
        self.reach = self.effective(self.max_current)
        """Effective current of each coil at its limit (N,) [A]."""
        self._asked, self._background = settings.axes, 1e-3 * np.array(settings.background_mT)

    @cached_property
    def axes(self) -> int:
        """Components of the field that the coils are for: 2 for x and y, 3 for z too."""
        if self._asked:
            return len(self._asked)
        strength = np.linalg.svd(self.actuation_matrix() * self.reach, compute_uv=False)
        return 3 if len(strength) == 3 and strength[2] > _MEANT * strength[0] else 2

    @cached_property
    def background(self) -> np.ndarray:
        """Field (axes,) [T] that is there without current."""
        return np.append(self._background, 0.0)[:self.axes]

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Field of each coil [T/A]: (N, M, 3)."""
        points = as_points(points)
        return np.stack([source.field_per_ampere(points) for source in self._sources])

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Gradient of each coil, `[..., i, j]` = ∂Bᵢ/∂xⱼ [T/m/A]: (N, M, 3, 3)."""
        points = as_points(points)
        return np.stack([source.gradient_per_ampere(points) for source in self._sources])

    def field(self, currents: ArrayLike, points: ArrayLike) -> np.ndarray:
        """Field [T] of currents (N,) [A]: (M, 3)."""
        return np.tensordot(self.effective(currents), self.field_per_ampere(points), 1)

    def gradient(self, currents: ArrayLike, points: ArrayLike) -> np.ndarray:
        """Gradient ∂Bᵢ/∂xⱼ [T/m] of currents (N,) [A]: (M, 3, 3)."""
        return np.tensordot(self.effective(currents), self.gradient_per_ampere(points), 1)

    def effective(self, currents: ArrayLike) -> np.ndarray:
        """What currents (..., N) [A] are worth in field [A]; the same without a saturation."""
        found = np.asarray(currents)
        if self._curves:
            found = found.astype(float)
            for coil, curve in self._curves.items():
                found[..., coil] = curve.effective(found[..., coil])
        return found

    def driven(self, effective: np.ndarray) -> np.ndarray:
        """The currents (..., N) [A] that are worth `effective` ones (..., N) [A]."""
        if self._curves:
            effective = effective.copy()
            for coil, curve in self._curves.items():
                effective[..., coil] = curve.driven(effective[..., coil])
        return effective

    def actuation_matrix(self, point: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Field at one point per ampere in each coil [T/A]: (3, N)."""
        return self.field_per_ampere(np.reshape(point, (1, -1)))[:, 0].T

    def power(self, currents: ArrayLike) -> float:
        """Heat in the windings [W] under currents (N,) [A]."""
        return float(np.square(currents) @ self.resistance)
