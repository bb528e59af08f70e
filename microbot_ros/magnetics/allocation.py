"""Coil currents for a wanted field: least power within exact limits, direction before magnitude.

N currents make two or three field components, A I + background = wanted. The remaining freedom
minimises the heat Σ R I². The limits |Iₖ| ≤ Lₖ are met exactly, without scaling or clipping:

* The reachable fields are the zonotope {A I : |Iₖ| ≤ Lₖ}. Each of its faces is spanned by columns
  of A, one fewer than there are components. The largest field along a direction is where a ray
  leaves the zonotope: the smallest of a few quotients, which solves the linear programme.
* The least-power currents of a field inside are the unlimited ones, I₀, plus a mixture Z y of
  currents that make no field. With Z orthonormal in the heat, the least heat is the shortest y
  with |I₀ + Z y| ≤ L, a small quadratic programme (`allocation_kernels.py`).
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.errors import InputError
from microbot_ros.magnetics.coils import CoilSet

# Choice: a direction with less than this part of the field of the best direction counts as one
# that the coils cannot make; rounding is around 1e-12.
_SINGULAR = 1e-6
_ALL_ROUND = 2000  # choice: directions on the sphere, 2.5° apart


class Allocation(NamedTuple):
    """Currents for a wanted field, and what they make.

    Attributes
    ----------
    currents : (N,) array [A]
    field : (axes,) array [T]
        Field at the point, background included.
    power : float
        Heat in the windings [W].
    saturated : bool
        Whether the limits reduced the magnitude of the field; its direction is kept.
    """

    currents: np.ndarray
    field: np.ndarray
    power: float
    saturated: bool


class Allocator:
    """Coil currents for wanted fields at one point of the workspace.

    Fields have the components of `coils.axes`. With three axes, a field of two components lies in
    the plane.

    Parameters
    ----------
    coils : CoilSet
        Coils with their limits and background.
    point : (3,) array [m]
        Point at which the coils make the field.

    Raises
    ------
    InputError
        If the coils cannot make every field direction at the point (the message names the
        direction), a wire lies at the point, or the background exceeds what the coils can cancel.
    """

    def __init__(self, coils: CoilSet, point: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        from microbot_ros.magnetics.allocation_kernels import within_limits
        axes = coils.axes
        self.matrix = coils.actuation_matrix(point)[:axes]
        """Field at the point per (effective) ampere, (axes, N) [T/A]."""
        self._coils, self._background, self._limits = coils, coils.background, coils.reach
        _refuse_singular(self.matrix, point)
        self._cost = np.diag(np.sqrt(coils.resistance))
        spare = np.linalg.svd(self.matrix)[2][axes:].T
        count = len(coils.names)
        cheapest = np.eye(count) - spare @ np.linalg.pinv(self._cost @ spare) @ self._cost
        self._unlimited = cheapest @ np.linalg.pinv(self.matrix)
        triangle = np.linalg.qr(self._cost @ spare, mode='r')
        self._spare = np.ascontiguousarray(spare @ np.linalg.inv(triangle))
        self._within = within_limits
        self._within(0 * self._limits, self._spare, self._limits)  # compiled now, not when driven
        normals = _normals(self.matrix)
        self._normals = np.vstack([normals, -normals])
        reach = np.abs(self._normals @ self.matrix) @ self._limits
        self._reach = reach + self._normals @ self._background
        if not np.all(self._reach >= 0):
            raise InputError('background_mT', 'expected a field that the coils can cancel')

    @property
    def linear(self) -> np.ndarray:
        """Least-power currents per tesla without limits, (N, axes) [A/T]."""
        return self._unlimited

    def allocate(self, wanted: ArrayLike) -> Allocation:
        """Return the least-power currents for the field `wanted` (axes,) [T].

        If the limits do not allow the magnitude, the largest field in its direction is made. A
        zero field cancels the background. Raises ValueError for NaN and infinity.

        Parameters
        ----------
        wanted : ArrayLike, shape (axes,)
            Field [T].

        Returns
        -------
        Allocation
            The currents and the field that they make.
        """
        currents, saturated = self.cheapest(np.asarray(wanted, dtype=float))
        return Allocation(currents, self.field(currents), self._coils.power(currents), saturated)

    def cheapest(self, wanted: np.ndarray) -> tuple[np.ndarray, bool]:
        """Return the currents (N,) [A] and `saturated` of `allocate` for a field (axes,) [T].

        Raises ValueError for NaN and infinity.

        Parameters
        ----------
        wanted : ndarray, shape (axes,)
            Field [T].

        Returns
        -------
        tuple[ndarray, bool]
            Currents (N,) [A], and whether they are reduced by the limits.
        """
        wanted = self._components(wanted)
        magnitude = math.hypot(*wanted.tolist())
        if not magnitude < math.inf:
            raise ValueError(f'wanted field must be finite; received {wanted}')
        currents = self._unlimited @ (wanted - self._background)
        if (np.abs(currents) <= self._limits).all():
            return self._coils.driven(currents), False
        largest = self.largest(wanted) if magnitude > 0 else 0.0
        saturated = magnitude > largest
        target = wanted * (largest / magnitude) if saturated else wanted
        start = self._unlimited @ (target - self._background)
        return self._coils.driven(self._within(start, self._spare, self._limits)), saturated

    def currents(self, wanted: np.ndarray) -> np.ndarray:
        """Return the currents (K, N) [A] of `allocate` for each field `wanted` (K, axes) [T].

        Raises ValueError for NaN and infinity.

        Parameters
        ----------
        wanted : ndarray, shape (K, axes)
            Fields [T].

        Returns
        -------
        ndarray, shape (K, N)
            Currents [A].
        """
        wanted = self._components(wanted)
        found = (wanted - self._background) @ self._unlimited.T
        within = (np.abs(found) <= self._limits).all(axis=1)
        found[within] = self._coils.driven(found[within])
        for row in np.flatnonzero(~within).tolist():
            found[row], _ = self.cheapest(wanted[row])
        return np.asarray(found)

    def field(self, currents: np.ndarray) -> np.ndarray:
        """Return the field (axes,) [T] at the point for `currents` (N,) [A], with background.

        Parameters
        ----------
        currents : ndarray, shape (N,)
            Current of each coil [A].

        Returns
        -------
        ndarray, shape (axes,)
            Field [T].
        """
        return np.asarray(self.matrix @ self._coils.effective(currents) + self._background)

    def largest(self, direction: ArrayLike) -> float:
        """Return the largest field [T] within the limits along `direction` (axes,), of any length.

        Raises ValueError for a zero direction, NaN and infinity.

        Parameters
        ----------
        direction : ArrayLike, shape (axes,)
            Direction, of any length.

        Returns
        -------
        float
            Magnitude [T].
        """
        across = self._normals @ _unit(self._components(np.asarray(direction, dtype=float)))
        outward = across > 0
        return float((self._reach[outward] / across[outward]).min())

    def largest_current(self, magnitude: float) -> float:
        """Return the largest coil current [A] for a field of `magnitude` [T] in any direction.

        Parameters
        ----------
        magnitude : float
            Magnitude of the field [T].

        Returns
        -------
        float
            Current [A].
        """
        angles = np.radians(np.arange(360.0))
        around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        if self._coils.axes == 3:
            around = np.vstack([np.column_stack([around, 0 * angles]), _all_round()])
        return float(np.abs(self.currents(magnitude * around)).max())

    def _components(self, vector: np.ndarray) -> np.ndarray:
        """Return vectors (..., 2 or axes) with `axes` components; a missing third is 0."""
        axes = self._coils.axes
        if vector.shape[-1:] == (axes,):
            return vector
        if vector.shape[-1:] == (2,):
            return np.concatenate([vector, np.zeros((*vector.shape[:-1], 1))], axis=-1)
        raise ValueError(f'expected {axes} components; received {vector}')


def _refuse_singular(matrix: np.ndarray, point: ArrayLike) -> None:
    """Raise InputError if coils with this `matrix` (axes, N) lack a direction of the field."""
    axes, count = matrix.shape
    if not np.isfinite(matrix).all():
        raise InputError('coils', f'expected coils for every field direction at {point!r} m; '
                         'a wire or the end of a map is there')
    if count < axes:
        raise InputError('coils', f'expected at least {axes} coils for {axes} axes, found {count}')
    directions, size, _ = np.linalg.svd(matrix)
    if not size[-1] > _SINGULAR * size[0]:
        raise InputError('coils', f'expected coils for every field direction at {point!r} m; '
                         f'these make no field along {_in_words(directions[:, -1])}')


def _normals(columns: np.ndarray) -> np.ndarray:
    """Return unit vectors (F, d) perpendicular to every choice of d − 1 of the columns (d, N).

    For collinear columns this is one of several perpendicular vectors. No face lies there, but the
    bound on the zonotope along it still holds.
    """
    choices = list(combinations(range(columns.shape[1]), len(columns) - 1))
    return np.linalg.svd(columns.T[choices])[2][:, -1]


def _in_words(direction: np.ndarray) -> str:
    """Format a direction: its axis, if it lies along one, and its unit vector."""
    unit = direction / np.linalg.norm(direction)
    main = int((np.abs(unit) > 0.999 * np.abs(unit).max()).argmax())  # of equal ones the first
    unit = unit * np.sign(unit[main]) + 0.0
    name = f'{"xyz"[main]} ' if unit[main] > 0.999 else ''
    return f'{name}({", ".join(f"{part:.2f}" for part in [*unit, 0.0][:3])})'


def _all_round() -> np.ndarray:
    """Return unit vectors (K, 3) spread evenly over the sphere (Fibonacci spiral)."""
    step = np.arange(_ALL_ROUND) + 0.5
    z, angle = 1 - 2 * step / _ALL_ROUND, np.pi * (1 + math.sqrt(5)) * step
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _unit(direction: np.ndarray) -> np.ndarray:
    length = math.hypot(*direction)
    if not 0 < length < math.inf:
        raise ValueError(f'direction must be finite and not zero; received {direction}')
    return direction / length
