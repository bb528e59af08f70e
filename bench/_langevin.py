"""Brownian motion of self-propelled magnetic spheres: the overdamped Langevin equations.

    dp = (F / 6πηr) ê(θ) dt + √(2D) dW,
    dθ = (d|B| / 8πηr³) sin(θ_B + φ − θ) dt + √(2 D_r) dW_r,

with D and D_r from the Einstein relation. A reference for the worlds of the virtual rig.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.records import Commands
from microbot_ros.model.physics.langevin import Path, step_grid, step_heading
from microbot_ros.model.physics.particle import (
    Fluid,
    Particle,
    rotational_diffusion,
    rotational_drag,
    speed_from_force,
    translational_diffusion,
)


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
