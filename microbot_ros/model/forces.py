"""Forces and velocities on a sphere: fuel, heat, rolling, neighbours.

Plain formulas on arrays, vectors in the plane along the last axis (..., 2), broadcasting. The
magnetic force and torque of coils are in `microbot_ros.magnetics.force`.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.model.particle import Fluid, stokes_drag
from microbot_ros.units import MU_0


def unit(angle: np.ndarray | float) -> np.ndarray:
    """Unit vectors (..., 2) at angles (...) [rad]."""
    return np.stack((np.cos(angle), np.sin(angle)), axis=-1)


def propulsion_force(
    coefficient: float, concentration: np.ndarray | float, heading: np.ndarray,
) -> np.ndarray:
    """Catalytic propulsion (..., 2) [N], proportional to the fuel and along the heading.

    `coefficient` is the force per unit of `concentration`, in whatever unit that is given
    (volume fraction of H₂O₂, say).
    """
    return np.asarray(coefficient * concentration)[..., None] * unit(heading)


def thermophoretic_velocity(
    displacement: np.ndarray, width: float, heating: float, mobility: float,
) -> np.ndarray:
    """Velocity (..., 2) [m/s] about a spot that a laser heats: −D_T ∇T.

    The spot is a Gaussian of standard deviation `width` [m] and peak rise `heating` [K];
    `displacement` [m] is from its centre; `mobility` D_T [m²/s/K], positive away from heat
    (Duhr & Braun, PNAS 2006). Fastest, D_T·heating/(width·√e), at one width.
    """
    displacement = np.asarray(displacement)
    squared = np.sum(displacement**2, axis=-1, keepdims=True) / width**2
    velocity: np.ndarray = (
        mobility * heating / width**2 * np.exp(-squared / 2) * displacement)
    return velocity


def rolled_frequency(
    frequency: np.ndarray, cut_in: float = 0.0, step_out: float = math.inf,
) -> np.ndarray:
    """How often a roller turns, on average, in a field rotating at `frequency` [Hz].

    Below `cut_in` the surface holds it, and it takes up √(f² − cut_in²) above; beyond `step_out`,
    where drag exceeds the magnetic torque, it slips and keeps f − √(f² − step_out²) (the averaged
    Adler equation, for either barrier alone). The sign of `frequency` is kept.
    """
    drive = np.abs(np.asarray(frequency, dtype=float))
    free = np.sqrt(np.maximum(drive**2 - cut_in**2, 0.0))
    with np.errstate(divide='ignore'):
        slipping = np.sqrt(np.maximum(1 - (step_out / drive) ** 2, 0.0))
    return np.copysign(free * (1 - slipping), frequency)


def rolling_speed(
    radius: float, frequency: np.ndarray, grip: float, cut_in: float = 0.0,
    step_out: float = math.inf,
) -> np.ndarray:
    """Speed [m/s] of a roller: `grip` times the 2πrf of rolling without slip.

    `grip` runs from 0, far from the wall, to 1 on a dry one (Goldman, Cox & Brenner, 1967, for
    a lubricated one in between); the rest as in `rolled_frequency`.
    """
    return grip * 2 * math.pi * radius * rolled_frequency(frequency, cut_in, step_out)


def dipole_force(moment: np.ndarray, other: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Force (..., 2) [N] on a point dipole by another; `displacement` (..., 2) [m] is from it.

    3µ₀/4πr⁴ [(m₁·r̂)m₂ + (m₂·r̂)m₁ + (m₁·m₂)r̂ − 5(m₁·r̂)(m₂·r̂)r̂] (Jackson, §5.7): side by side,
    parallel moments repel; head to tail they attract. Undefined (NaN) at no distance.
    """
    moment, other, displacement = (np.asarray(a) for a in (moment, other, displacement))
    distance = np.linalg.norm(displacement, axis=-1, keepdims=True)
    with np.errstate(divide='ignore', invalid='ignore'):
        towards = displacement / distance
        first = np.sum(moment * towards, axis=-1, keepdims=True)
        second = np.sum(other * towards, axis=-1, keepdims=True)
        both = np.sum(moment * other, axis=-1, keepdims=True)
        force: np.ndarray = 3 * MU_0 / (4 * math.pi * distance**4) * (
            first * other + second * moment + (both - 5 * first * second) * towards)
    return force


def swimmer_flow(strength: float, heading: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Velocity (..., 2) [m/s] of the fluid about a swimmer: a Stokes dipole along its heading.

    strength·(3cos²ϑ − 1) r̂ / r², strength [m³/s] positive for a pusher (Lauga & Powers, 2009);
    `displacement` (..., 2) [m] from the swimmer. Undefined (NaN) at no distance.
    """
    displacement = np.asarray(displacement)
    distance = np.linalg.norm(displacement, axis=-1, keepdims=True)
    with np.errstate(divide='ignore', invalid='ignore'):
        towards = displacement / distance
        cosine = np.sum(unit(heading) * towards, axis=-1, keepdims=True)
        velocity: np.ndarray = strength * (3 * cosine**2 - 1) / distance**2 * towards
    return velocity


def dipole_mobility(fluid: Fluid, radius: float, moment: float) -> float:
    """3µ₀m²/4π over 6πηr [m⁵/s]: the speed by which equal dipoles move each other is this/r⁴."""
    return 3 * MU_0 * moment**2 / (4 * math.pi) / stokes_drag(fluid, radius)
