"""Magnetic force and torque on a particle, and where in the workspace the force matters.

The steering model leaves the force V (M·∇)B out. Whether it may depends on the particle's moment,
which the paper does not give. Assumed here: 1 kA/m, about what 1 % by volume of magnetite
(480 kA/m at saturation) with a remanence of a fifth would keep. Every number is proportional to
it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.magnetics.allocation import Allocator
from microbot_ros.magnetics.coils import CoilSet

_DIRECTIONS = 72  # of the field, and of the places on a circle: every 5°
_RINGS = 50


@dataclass(frozen=True)
class MagneticParticle:
    """A magnetised sphere in a fluid; by default the paper's, with an assumed magnetisation.

    `radius` [m], `viscosity` [Pa s], `speed` of its own propulsion [m/s] (the slowest of the
    paper's three), `magnetisation` [A/m].
    """

    radius: float = 4.6e-6
    viscosity: float = 1.245e-3
    speed: float = 3.71e-6
    magnetisation: float = 1e3

    @property
    def moment(self) -> float:
        """Magnetic moment [A m²]."""
        return 4 / 3 * math.pi * self.radius**3 * self.magnetisation

    @property
    def drag(self) -> float:
        """Stokes's friction 6πηr [N s/m]."""
        return 6 * math.pi * self.viscosity * self.radius

    def alignment_time(self, field: float) -> float:
        """Time constant [s] of turning into a field [T]: 8πηr³ over moment times field."""
        return 8 * math.pi * self.viscosity * self.radius**3 / (self.moment * field)


def force(moment: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Force (m·∇)B [N] on moments (..., 3) [A m²] in gradients (..., 3, 3) [T/m]: (..., 3)."""
    return np.einsum('...j,...ij->...i', moment, gradient)


def torque(moment: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Torque m × B [N m] on moments (..., 3) [A m²] in fields (..., 3) [T]: (..., 3)."""
    return np.cross(moment, field)


def force_speed(
    coils: CoilSet, points: np.ndarray, magnitude: float, particle: MagneticParticle,
) -> np.ndarray:
    """Speed (M,) [m/s] at which the force drags the particle in the plane, at its worst.

    The coils make a field of `magnitude` [T] at the centre, in the direction in the plane that is
    worst for each of the points (M, 3) or (M, 2) [m]; the moment has turned into the field there.
    InputError for a magnitude that is not positive or that the coils can't make all round.
    """
    if not 0 < magnitude < math.inf:
        raise InputError('magnitude', f'expected a positive field, got {magnitude} T')
    allocator = Allocator(coils)
    angles = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    wanted = magnitude * np.column_stack([np.cos(angles), np.sin(angles)])
    allocations = [allocator.allocate(field) for field in wanted]
    if any(allocation.saturated for allocation in allocations):
        raise InputError('magnitude', f"expected a field in the coils' reach, got {magnitude} T")
    currents = np.array([allocation.currents for allocation in allocations])
    field = np.tensordot(currents, coils.field_per_ampere(points), 1)
    field[..., :coils.axes] += coils.background
    gradient = np.tensordot(currents, coils.gradient_per_ampere(points), 1)
    aligned = particle.moment * field / np.linalg.norm(field, axis=-1, keepdims=True)
    drag_speed = np.linalg.norm(force(aligned, gradient)[..., :2], axis=-1) / particle.drag
    return drag_speed.max(axis=0)


def negligible_radius(
    coils: CoilSet, magnitude: float, particle: MagneticParticle | None = None,
    fraction: float = 0.01, within: float = 10e-3,
) -> float:
    """Radius [m] about the centre inside which the force stays below a part of the propulsion.

    Inside it `force_speed` at a field of `magnitude` [T] is nowhere more than `fraction` of the
    particle's own speed. 0 where it is already at the centre; `within` [m] where it is not up to
    there. InputError as `force_speed`.
    """
    particle = particle or MagneticParticle()
    angles = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])

    def excess(radius: float) -> float:
        worst = force_speed(coils, radius * circle, magnitude, particle).max()
        return float(worst / particle.speed - fraction)

    inner = 0.0
    if excess(inner) > 0:
        return inner
    from scipy.optimize import brentq
    for outer in np.linspace(0, within, _RINGS + 1)[1:]:
        if not excess(outer) <= 0:
            return float(brentq(excess, inner, outer, xtol=1e-9))
        inner = outer
    return within
