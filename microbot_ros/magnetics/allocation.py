"""Coil currents for a wanted in-plane field: least power, exact limits, direction first.

Four currents make two components of field, A I + background = wanted, so two degrees of freedom
are spare. They go to the least heat Σ R I², or, where asked, to cancelling the in-plane gradient
first. Limits |Iₖ| ≤ Lₖ are met exactly, not by scaling or clipping:

* What the coils can reach is the zonotope {A I : |Iₖ| ≤ Lₖ}, a polygon whose edges lie along the
  columns of A. The largest field along a direction is where a ray leaves it: the smallest of
  eight quotients, which is the solution of the linear programme.
* The least-power currents of a field inside have some coils at a limit and the rest free. Given
  which, they are an affine function of the field, worked out beforehand for every choice that
  leaves two dimensions of field to the free coils. Every choice that respects the limits is a
  candidate, the optimum is among them, so the cheapest candidate is the optimum.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.errors import InputError
from microbot_ros.magnetics.coils import CoilSet

# With the gradient to cancel, a gradient weighs this much more than the heat, both measured in
# their largest singular value: what can be cancelled is, to 1e-8 of what it was.
_GRADIENT_WEIGHT = 1e4
# Free coils whose columns span less than this part of the plane's second dimension span a line.
_IN_LINE = 1e-6
# The same field to rounding: a choice of free coils this close to its limits respects them.
_ROUNDING = 1e-9


class Allocation(NamedTuple):
    """Currents (4,) [A], the in-plane field (2,) [T] they make with the background, the heat.

    `power` is the heat [W]. `saturated`: the limits did not allow the wanted magnitude; the
    direction is kept.
    """

    currents: np.ndarray
    field: np.ndarray
    power: float
    saturated: bool


class Allocator:
    """Currents from wanted fields at one point (3,) [m] of the workspace.

    `cancel_gradient`: the in-plane gradient counts before the heat. InputError where the coils
    can't make every direction of field at the point, as on a wire, or can't cancel the background
    within their limits.
    """

    def __init__(
        self, coils: CoilSet, point: ArrayLike = (0.0, 0.0, 0.0), cancel_gradient: bool = False,
    ) -> None:
        self.matrix = coils.actuation_matrix(point)[:2]
        """In-plane field at the point per ampere (2, 4) [T/A]."""
        self._background, self._limits = coils.background, coils.max_current
        self._resistance = coils.resistance
        self._cost = np.diag(np.sqrt(coils.resistance))
        finite = np.isfinite(self.matrix).all()
        if cancel_gradient and finite:
            gradient = coils.gradient_per_ampere(np.reshape(point, (1, -1)))[:, 0, :2, :2]
            gradient = gradient.reshape(4, 4).T
            weight = _GRADIENT_WEIGHT * self._cost.max() / np.linalg.norm(gradient, 2)
            self._cost = np.vstack([weight * gradient, self._cost])
        unlimited = self._face(np.zeros(4)) if finite else None
        if unlimited is None:
            raise InputError('coils', f'expected coils for every field direction at {point!r} m')
        self._unlimited = unlimited[0]
        normals = np.stack([-self.matrix[1], self.matrix[0]], axis=1)
        self._normals = np.vstack([normals, -normals])
        reach = np.abs(self._normals @ self.matrix) @ self._limits
        self._reach = reach + self._normals @ self._background
        if not np.all(self._reach >= 0):
            raise InputError('background_mT', 'expected a field that the coils can cancel')

    @property
    def linear(self) -> np.ndarray:
        """The cheapest currents without limits (N, axes) [A/T], per field made."""
        return self._unlimited

    def allocate(self, wanted: ArrayLike) -> Allocation:
        """The cheapest currents for a field (2,) [T], or for the most of it that can be had.

        A zero field cancels the background. ValueError for NaN or infinity: nothing to drive.
        """
        currents, saturated = self.cheapest(np.asarray(wanted, dtype=float))
        field = self.matrix @ currents + self._background
        return Allocation(currents, field, float(currents**2 @ self._resistance), saturated)

    def cheapest(self, wanted: np.ndarray) -> tuple[np.ndarray, bool]:
        """Of what `allocate` gives for a field (2,) [T], the currents (4,) [A] and `saturated`.

        ValueError as there.
        """
        magnitude = math.hypot(*wanted.tolist())
        if not magnitude < math.inf:
            raise ValueError(f'wanted field must be finite; received {wanted}')
        currents = self._unlimited @ (wanted - self._background)
        if (np.abs(currents) <= self._limits).all():
            return currents, False
        largest = self.largest(wanted) if magnitude > 0 else 0.0
        saturated = magnitude > largest
        target = wanted * (largest / magnitude) if saturated else wanted
        return self._limited(target - self._background), saturated

    def currents(self, wanted: np.ndarray) -> np.ndarray:
        """The currents (K, 4) [A] that `allocate` gives for each field `wanted` (K, 2) [T].

        ValueError as there.
        """
        found = (wanted - self._background) @ self._unlimited.T
        for row in np.flatnonzero(~(np.abs(found) <= self._limits).all(axis=1)).tolist():
            found[row], _ = self.cheapest(wanted[row])
        return np.asarray(found)

    def largest(self, direction: ArrayLike) -> float:
        """The largest field [T] within the limits along a direction (2,) of any length.

        ValueError for a zero direction, NaN or infinity.
        """
        across = self._normals @ _unit(direction)
        outward = across > 0
        return float((self._reach[outward] / across[outward]).min())

    def largest_current(self, magnitude: float) -> float:
        """The largest current [A] that any coil needs for a field of `magnitude` [T] turned all
        round.
        """
        angles = np.radians(np.arange(360.0))
        fields = magnitude * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return max(float(np.abs(self.allocate(field).currents).max()) for field in fields)

    def _limited(self, field: np.ndarray) -> np.ndarray:
        """The cheapest currents (4,) [A] within the limits for a field (2,) [T] in reach."""
        slopes, offsets = self._faces
        candidates = slopes @ field + offsets
        excess = (np.abs(candidates) / self._limits).max(axis=1)
        candidates = candidates[excess <= max(1.0, excess.min()) + _ROUNDING]
        cost = np.square(candidates @ self._cost.T).sum(axis=1)
        return np.clip(candidates[cost.argmin()], -self._limits, self._limits)

    @cached_property
    def _faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (F, 4, 2) and offsets (F, 4) of the currents for each choice of free coils."""
        choices = (self._face(np.array(at) * self._limits) for at in product((0, 1, -1), repeat=4))
        slopes, offsets = zip(*(face for face in choices if face is not None), strict=True)
        return np.array(slopes), np.array(offsets)

    def _face(self, fixed: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The cheapest currents, slope (4, 2) and offset (4,), with the non-zero `fixed` given.

        None where the free coils are too few, or too much in line, for every field.
        """
        free = fixed == 0
        singular = np.linalg.svd(self.matrix * free, compute_uv=False)
        if singular[1] < _IN_LINE * np.linalg.norm(self.matrix):
            return None
        make = np.linalg.pinv(self.matrix * free)
        held = np.vstack([self.matrix * free, np.eye(4)[~free]])
        spare = np.linalg.svd(held)[2][len(held):].T
        cheapest = np.eye(4) - spare @ np.linalg.pinv(self._cost @ spare) @ self._cost
        offset = cheapest @ (fixed - make @ self.matrix @ fixed)
        return np.where(free[:, None], cheapest @ make, 0), np.where(free, offset, fixed)


def _unit(direction: ArrayLike) -> np.ndarray:
    direction = np.asarray(direction, dtype=float)
    length = math.hypot(*direction)
    if not 0 < length < math.inf:
        raise ValueError(f'direction must be finite and not zero; received {direction}')
    return direction / length
