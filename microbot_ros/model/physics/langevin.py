"""Brownian motion of self-propelled magnetic spheres: the overdamped Langevin equations.

    dp = (F / 6πηr) ê(θ) dt + √(2D) dW,
    dθ = (d|B| / 8πηr³) sin(θ_B + φ − θ) dt + √(2 D_r) dW_r,

with D and D_r from the Einstein relation. Inertia, microseconds, is left out; `newton_stokes`
has it. In each step the turn into the field is solved exactly and the noise is that of the
equation linearised about the heading (Ozaki's scheme), so a step may be longer than the time in
which the heading aligns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.records import Commands
from microbot_ros.model.physics.particle import (
    Fluid,
    Particle,
    rotational_diffusion,
    rotational_drag,
    speed_from_force,
    translational_diffusion,
)

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


def simulate_langevin(
    fluid: Fluid,
    particles: Sequence[Particle],
    commands: Commands,
    times: np.ndarray,
    rng: np.random.Generator,
    position: np.ndarray | None = None,
    heading: np.ndarray | None = None,
) -> Path:
    """One realisation of N particles at `times` (T,) [s], ascending, in steps of 1 ms at most.

    `commands` holds the uniform field; each step takes the one in force at its middle. Starts
    from `position` (N, 2) [m], all at the origin if None, and `heading` (N,) [rad], drawn evenly
    from the circle if None. The first row of the path is the start. Where the field is zero the
    heading diffuses freely. The same generator state gives the same path.
    """
    count = len(particles)
    radius = np.array([p.radius for p in particles])
    spheres = (
        speed_from_force(fluid, radius, np.array([p.force for p in particles])),
        np.array([p.phi for p in particles]),
        np.array([p.moment for p in particles]) / rotational_drag(fluid, radius),
        translational_diffusion(fluid, radius),
        rotational_diffusion(fluid, radius),
    )
    position = np.zeros((count, 2)) if position is None else np.array(position, dtype=float)
    if heading is None:
        heading = rng.uniform(-math.pi, math.pi, count)
    path = Path(np.asarray(times), np.empty((len(times), count, 2)), np.empty((len(times), count)))
    path.position[0], path.heading[0] = position, heading
    heading = path.heading[0].copy()
    for k in range(1, len(times)):
        middle, length = step_grid(times[k - 1], times[k])
        field = commands.field_at(middle)
        strength, direction = np.hypot(*field.T), np.arctan2(field[:, 1], field[:, 0])
        _advance(position, heading, strength, direction, length, rng, *spheres)
        path.position[k], path.heading[k] = position, heading
    return path


@numba.njit(cache=True)
def _advance(
    position: np.ndarray, heading: np.ndarray, strength: np.ndarray, direction: np.ndarray,
    length: float, rng: np.random.Generator, speed: np.ndarray, phi: np.ndarray,
    rate_per_tesla: np.ndarray, diffusion: np.ndarray, heading_diffusion: np.ndarray,
) -> None:
    """Step every sphere, in place, through the fields of successive steps of equal length."""
    for i in range(len(heading)):
        spread = math.sqrt(2 * diffusion[i] * length)
        for k in range(len(strength)):
            before = heading[i]
            heading[i] = step_heading(
                before, direction[k] + phi[i], rate_per_tesla[i] * strength[k],
                heading_diffusion[i], length, rng.standard_normal(),
            )
            during = (before + heading[i]) / 2
            position[i, 0] += (
                speed[i] * math.cos(during) * length + spread * rng.standard_normal())
            position[i, 1] += (
                speed[i] * math.sin(during) * length + spread * rng.standard_normal())
