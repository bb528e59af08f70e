"""Forces and velocities on a sphere by textbook formulas, for tests to compare with.

Plain formulas on arrays, vectors in the plane along the last axis (..., 2), broadcasting.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_banded

from microbot_ros.common.units import MU_0
from microbot_ros.model.physics.particle import Fluid, stokes_drag
from microbot_ros.model.physics.vectors import unit


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


def sliding_near_a_wall(height: float, radius: float) -> float:
    """Drag over 6πηa of a sphere that moves along a plane wall without turning: the exact series.

    In bispherical coordinates (O'Neill, Mathematika 11, 67 (1964), in the notation of Goldman, Cox
    & Brenner (1967)): a tridiagonal system for the coefficients A, from which the force follows.
    """
    alpha = math.acosh(height / radius)
    count = max(40, round(40 / alpha))
    n = np.arange(count + 1.0)

    def k(order: np.ndarray) -> np.ndarray:
        return (order + 0.5) / np.tanh((order + 0.5) * alpha) - 1 / math.tanh(alpha)

    m = n[1:]
    before = (2 * m - 1) * k(m - 1) - (2 * m - 3) * k(m)
    after = (2 * m + 5) * k(m) - (2 * m + 3) * k(m + 1)
    bands = np.zeros((3, count))
    bands[0, 1:] = (after * (m + 2) / (2 * m + 3))[:-1]
    bands[1] = -(before * m + after * (m + 1)) / (2 * m + 1)
    bands[2, :-1] = (before * (m - 1) / (2 * m - 1))[1:]
    wanted = math.sqrt(2) * (2 / np.tanh((m + 0.5) * alpha) - 1 / np.tanh((m - 0.5) * alpha)
                             - 1 / np.tanh((m + 1.5) * alpha))
    a = np.concatenate([[0.0, 0.0], solve_banded((1, 1), bands, wanted), [0.0]])
    low, here, high = a[:-2], a[1:-1], a[2:]
    c = -2 * k(n) * ((n - 1) / (2 * n - 1) * low - here + (n + 2) / (2 * n + 3) * high)
    e = 4 * math.sqrt(2) / np.expm1(np.minimum((2 * n + 1) * alpha, 700.0)) + k(n) * (
        n * (n - 1) / (2 * n - 1) * low - (n + 1) * (n + 2) / (2 * n + 3) * high)
    return float(math.sqrt(2) / 6 * math.sinh(alpha) * (e + n * (n + 1) * c).sum())
