"""Steps of the overdamped Langevin equation of a heading in a field.

    dθ = (d|B| / 8πηr³) sin(θ_B + φ − θ) dt + √(2 D_r) dW_r,

with D_r from the Einstein relation. Inertia, microseconds, is left out; `newton_stokes` has it. In
each step the turn into the field is solved exactly and the noise is that of the equation
linearised about the heading (Ozaki's scheme), so a step may be longer than the time in which the
heading aligns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba

STEP = 1e-3
"""Longest time step [s]."""


@dataclass(frozen=True)
class Path:
    """Where particles went: times (T,) [s], position (T, N, 2) [m], heading (T, N) [rad].

    Headings are continuous, not wrapped to one turn.
    """

    t: np.ndarray
    position: np.ndarray
    heading: np.ndarray


@numba.njit(cache=True)
def align_heading(heading: float, target: float, angle: float) -> float:
    """The heading [rad] after turning by dθ/dt = κ sin(target − θ) for κ·time = `angle`.

    Exact: the half-angle tangent of target − θ decays as exp(−κt). At a right-about error, the
    unstable equilibrium, it stays.
    """
    error = (target - heading + math.pi) % (2 * math.pi) - math.pi
    left = 2 * math.atan(math.tan(error / 2) * math.exp(-angle))
    return heading + error - left


@numba.njit(cache=True)
def step_heading(
    heading: float, target: float, rate: float, diffusion: float, duration: float, normal: float,
) -> float:
    """The heading [rad] after `duration` [s]: turned at `rate` κ [1/s], spread by `diffusion`
    [rad²/s].

    `normal` is a standard normal number. About the target the spread is that of the linearised
    equation, D_r (1 − exp(−2κt)) / κ; away from it the free 2 D_r t.
    """
    settled = align_heading(heading, target, rate * duration)
    stiffness = 2 * rate * duration * max(math.cos(target - settled), 0.0)
    narrowing = -math.expm1(-stiffness) / stiffness if stiffness > 1e-9 else 1.0
    return settled + math.sqrt(2 * diffusion * duration * narrowing) * normal


def step_grid(start: float, end: float) -> tuple[np.ndarray, float]:
    """Mid-points [s] and length [s] of equal steps, none over STEP, from start to end."""
    count = max(math.ceil((end - start) / STEP - 1e-9), 1)
    length = (end - start) / count
    return start + (np.arange(count) + 0.5) * length, length
