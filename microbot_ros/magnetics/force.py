"""Magnetic force on a particle, and the region in which the force is negligible.

The steering model omits the force V (M·∇)B. Whether that is justified depends on the moment of the
particle, which the paper does not give. Assumed here: 1 kA/m, about what 1 % by volume of
magnetite (480 kA/m at saturation) with a remanence of one fifth keeps. All results are
proportional to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.magnetics.allocation import Allocator
from microbot_ros.magnetics.coils import CoilSet

_DIRECTIONS = 72  # choice: directions of the field, and positions on a circle, every 5°
_RINGS = 50  # choice: radii at which the limit is bracketed, every 0.2 mm of 10 mm


@dataclass(frozen=True)
class MagneticParticle:
    """Magnetised sphere in a fluid; by default that of the paper, with an assumed magnetisation.

    Attributes
    ----------
    radius : float [m]
    viscosity : float [Pa s]
    speed : float
        Self-propulsion [m/s]; by default the slowest of the three in the paper.
    magnetisation : float [A/m]
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
        """Stokes drag coefficient 6πηr [N s/m]."""
        return 6 * math.pi * self.viscosity * self.radius


def force(moment: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return (m·∇)B [N] for `moment` (..., 3) [A m²] and `gradient` (..., 3, 3) [T/m].

    Parameters
    ----------
    moment : ndarray, shape (..., 3)
        Magnetic moment [A m²].
    gradient : ndarray, shape (..., 3, 3)
        Gradient of the field [T/m].

    Returns
    -------
    ndarray, shape (..., 3)
        Force [N].
    """
    return np.einsum('...j,...ij->...i', moment, gradient)


def force_speed(
    coils: CoilSet, points: np.ndarray, magnitude: float, particle: MagneticParticle,
) -> np.ndarray:
    """Return the worst in-plane speed (M,) [m/s] at which the magnetic force drags the particle.

    The coils make the field at the centre, in the in-plane direction that is worst for each point;
    the moment is aligned with the field at the point.

    Parameters
    ----------
    coils : CoilSet
        Coils that make the field.
    points : (M, 3) or (M, 2) array [m]
        Positions of the particle.
    magnitude : float
        Field at the centre [T].
    particle : MagneticParticle
        Size and magnetisation of the particle, and viscosity of its fluid.

    Returns
    -------
    ndarray, shape (M,)
        Speed [m/s].

    Raises
    ------
    InputError
        If the magnitude is not positive or the coils cannot make it in every direction.
    """
    if not 0 < magnitude < math.inf:
        raise InputError('magnitude', f'expected a positive field; received {magnitude} T')
    allocator = Allocator(coils)
    angles = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    wanted = magnitude * np.column_stack([np.cos(angles), np.sin(angles)])
    allocations = [allocator.allocate(field) for field in wanted]
    if any(allocation.saturated for allocation in allocations):
        raise InputError('magnitude', "expected a field in the coils' reach; received "
                                      f'{magnitude} T')
    currents = coils.effective([allocation.currents for allocation in allocations])
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
    """Return the radius [m] about the centre inside which the force is negligible.

    Inside it, `force_speed` is nowhere more than `fraction` of the particle's own speed.

    Parameters
    ----------
    coils : CoilSet
        Coils that make the field.
    magnitude : float
        Field at the centre [T].
    particle : MagneticParticle, optional
        Particle that the force drags.
    fraction : float
        Speed by the force over the particle's own, up to which the force is negligible.
    within : float
        Largest radius examined [m]; returned if the force is negligible up to it.

    Returns
    -------
    float
        0 if the force is not negligible even at the centre.

    Raises
    ------
    InputError
        As `force_speed`.
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
