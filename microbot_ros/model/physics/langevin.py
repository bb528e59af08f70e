"""Steps of the overdamped Langevin equation of a heading in a field.

    dθ = (d|B| / 8πηr³) sin(θ_B + φ − θ) dt + √(2 D_r) dW_r,

with D_r from the Einstein relation. Inertia, of microseconds, is neglected; `newton_stokes` has
it. Each step solves the rotation into the field exactly, and its noise is that of the equation
linearised about the heading (Ozaki's scheme). A step may therefore be longer than the alignment
time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba

STEP = 1e-3
"""Longest time step [s]. Choice: the heading of a sphere of 1 µm spreads by 0.02 rad in it."""


@dataclass(frozen=True)
class Path:
    """Trajectories of N particles.

    Attributes
    ----------
    t : ndarray, shape (T,)
        Times [s].
    position : ndarray, shape (T, N, 2)
        Positions [m].
    heading : ndarray, shape (T, N)
        Headings [rad], continuous: not wrapped to one turn.
    """

    t: np.ndarray
    position: np.ndarray
    heading: np.ndarray


@numba.njit(cache=True)
def align_heading(heading: float, target: float, angle: float) -> float:
    """Return a heading after rotation by dθ/dt = κ sin(target − θ).

    Exact: the half-angle tangent of target − θ decays as exp(−κt). In exact opposition, the
    unstable equilibrium, the heading stays.

    Parameters
    ----------
    heading : float
        Heading [rad].
    target : float
        Heading that the field demands [rad].
    angle : float
        κ times the duration [rad].

    Returns
    -------
    float
        New heading [rad].
    """
    error = (target - heading + math.pi) % (2 * math.pi) - math.pi
    left = 2 * math.atan(math.tan(error / 2) * math.exp(-angle))
    return heading + error - left


@numba.njit(cache=True)
def step_heading(
    heading: float, target: float, rate: float, diffusion: float, duration: float, normal: float,
) -> float:
    """Return a heading after a time step with noise.

    About the target the variance is that of the linearised equation, D_r (1 − exp(−2κt)) / κ; away
    from it the free 2 D_r t.

    Parameters
    ----------
    heading : float
        Heading [rad].
    target : float
        Heading that the field demands [rad].
    rate : float
        κ [1/s].
    diffusion : float
        D_r [rad²/s].
    duration : float
        Duration [s].
    normal : float
        A standard normal number.

    Returns
    -------
    float
        New heading [rad].
    """
    settled = align_heading(heading, target, rate * duration)
    stiffness = 2 * rate * duration * max(math.cos(target - settled), 0.0)
    narrowing = -math.expm1(-stiffness) / stiffness if stiffness > 1e-9 else 1.0
    return settled + math.sqrt(2 * diffusion * duration * narrowing) * normal


def step_grid(start: float, end: float) -> tuple[np.ndarray, float]:
    """Divide a time interval into equal steps of at most STEP.

    Parameters
    ----------
    start, end : float
        Ends of the interval [s].

    Returns
    -------
    middles : ndarray
        Middles of the steps [s].
    length : float
        Length of a step [s].
    """
    count = max(math.ceil((end - start) / STEP - 1e-9), 1)
    length = (end - start) / count
    return start + (np.arange(count) + 0.5) * length, length
