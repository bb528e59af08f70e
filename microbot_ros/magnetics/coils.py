"""Field and gradient of all coils of a rig for given currents."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.magnetics.settings import CoilSettings
from microbot_ros.magnetics.sources import as_points

# Choice: coils count as three-axis above this ratio of their weakest to their strongest field
# direction, all at their limits. Four imperfectly placed coils in a plane reach 0.1.
_MEANT = 0.2


class CoilSet:
    """N coils in SI units; arrays over coils are in the order of `names`.

    Points are (M, 3) [m] in the workspace frame, or (M, 2) in the plane z = 0. Fields are those of
    the currents alone, without `background`, and NaN on a wire. A coil with a saturating core
    makes the field of an `effective` current; "per ampere" means per effective ampere. `settings`
    defaults to four coils in a plane.

    Parameters
    ----------
    settings : CoilSettings or None
        Settings of the coils; None for four coils in a plane.
    """

    def __init__(self, settings: CoilSettings | None = None) -> None:
        settings = settings or CoilSettings()
        windings = settings.windings
        self.names = tuple(winding.name for winding in windings)
        self.resistance = np.array([winding.resistance_ohm for winding in windings])
        """Resistance of each coil (N,) [Ω]."""
        self.max_current = np.array([winding.max_current_A for winding in windings])
        """Current limit of each coil in either direction (N,) [A]."""
        self._sources = [winding.made_by() for winding in windings]
        self._curves = {k: winding.curve() for k, winding in enumerate(windings)
                        if winding.saturation is not None}
        self.reach = self.effective(self.max_current)
        """Effective current of each coil at its limit (N,) [A]."""
        self._asked, self._background = settings.axes, 1e-3 * np.array(settings.background_mT)

    @cached_property
    def axes(self) -> int:
        """Number of field components that the coils can command: 2 (x, y) or 3 (with z)."""
        if self._asked:
            return len(self._asked)
        strength = np.linalg.svd(self.actuation_matrix() * self.reach, compute_uv=False)
        return 3 if len(strength) == 3 and strength[2] > _MEANT * strength[0] else 2

    @cached_property
    def background(self) -> np.ndarray:
        """Field (axes,) [T] without any current."""
        return np.append(self._background, 0.0)[:self.axes]

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return the field of each coil [T/A] at `points` (M, 3) [m], shape (N, M, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (N, M, 3)
            Field of each coil [T/A].
        """
        points = as_points(points)
        return np.stack([source.field_per_ampere(points) for source in self._sources])

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m/A] of each coil at `points` (M, 3) [m], shape (N, M, 3, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (N, M, 3, 3)
            Gradient of each coil [T/m/A].
        """
        points = as_points(points)
        return np.stack([source.gradient_per_ampere(points) for source in self._sources])

    def field(self, currents: ArrayLike, points: ArrayLike) -> np.ndarray:
        """Return the field [T] of `currents` (N,) [A] at `points` (M, 3) [m], shape (M, 3).

        Parameters
        ----------
        currents : ArrayLike, shape (N,)
            Current of each coil [A].
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3)
            Field [T].
        """
        return np.tensordot(self.effective(currents), self.field_per_ampere(points), 1)

    def gradient(self, currents: ArrayLike, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m] of `currents` (N,) [A] at `points` (M, 3) [m], shape (M, 3, 3).

        Parameters
        ----------
        currents : ArrayLike, shape (N,)
            Current of each coil [A].
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3, 3)
            Gradient [T/m].
        """
        return np.tensordot(self.effective(currents), self.gradient_per_ampere(points), 1)

    def effective(self, currents: ArrayLike) -> np.ndarray:
        """Convert `currents` (..., N) [A] to effective currents; the same without saturation.

        Parameters
        ----------
        currents : ArrayLike
            Currents (..., N) [A].

        Returns
        -------
        ndarray, shape (..., N)
            Effective currents [A].
        """
        found = np.asarray(currents)
        if self._curves:
            found = found.astype(float)
            for coil, curve in self._curves.items():
                found[..., coil] = curve.effective(found[..., coil])
        return found

    def driven(self, effective: np.ndarray) -> np.ndarray:
        """Convert `effective` currents (..., N) [A] to currents of the windings.

        Parameters
        ----------
        effective : ndarray, shape (..., N)
            Effective currents [A].

        Returns
        -------
        ndarray, shape (..., N)
            Currents of the windings [A].
        """
        if self._curves:
            effective = effective.copy()
            for coil, curve in self._curves.items():
                effective[..., coil] = curve.driven(effective[..., coil])
        return effective

    def actuation_matrix(self, point: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Return the field per ampere of each coil at one `point` (3,) [m], shape (3, N) [T/A].

        Parameters
        ----------
        point : ArrayLike, shape (3,)
            Point [m].

        Returns
        -------
        ndarray, shape (3, N)
            Field per ampere [T/A].
        """
        return self.field_per_ampere(np.reshape(point, (1, -1)))[:, 0].T

    def power(self, currents: ArrayLike) -> float:
        """Return the heat [W] in the windings for `currents` (N,) [A].

        Parameters
        ----------
        currents : ArrayLike, shape (N,)
            Current of each coil [A].

        Returns
        -------
        float
            Heat [W].
        """
        return float(np.square(currents) @ self.resistance)
