"""The paper's experiment on simulated particles: three of them, 15 s, two approaches, two solvers.

Beaver, Das & Malikopoulos, "A First-Order Approach to Model Simultaneous Control of Multiple
Microrobots". Its recording is not available, so the Langevin world replaces the rig.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.records import Commands, Session
from microbot_ros.estimation.one_leg_regression import one_leg
from microbot_ros.magnetics.force import MagneticParticle
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.newton_stokes import newton_stokes, stokes_translation
from microbot_ros.model.physics.particle import (
    Fluid,
    Particle,
    alignment_time,
    force_from_speed,
    rotational_time,
    speed_from_force,
    stokes_drag,
    translational_diffusion,
    translational_time,
)
from microbot_ros.model.physics.vectors import unit
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.record_session import Camera, record_session, scatter
from microbot_ros.virtual_rig.world import World

# The paper's numbers, in SI.
FLUID = Fluid(viscosity=1.245e-3, temperature=298.15)  # the paper; temperature assumed
RADIUS = 4.6e-6  # the paper [m]; see `summary.ASSUMED`
MASS = 4.01e-13  # the paper [kg]
FORCE = MASS * np.array([1.00, 1.18, 1.34])  # the paper [N]
PHI = np.array([-1.09, 3.82, 2.64])  # the paper [rad]
DURATION = 15.0  # the paper [s]
LEGS = (2.0, 6.0)  # the paper: shortest and longest leg [s]
STEP = 0.02  # the paper: step of Euler's method [s]

# Assumed, as the paper does not state them; listed on the page (`summary.ASSUMED`).
FIELD = 5e-3
MOMENT = MagneticParticle(radius=RADIUS, viscosity=FLUID.viscosity).moment
CAMERA = Camera(frame_rate=30.0, exposure=1.0, noise=0.1e-6)  # assumed, see `summary.ASSUMED`

APPROACHES = ('own', 'mean', 'true')
"""Force of each particle's own leg, mean force of the three, and the true force."""


@dataclass(frozen=True)
class Trial:
    """One repetition drawn by `seed`, with its session.

    `measured` (T, 3, 2) [m] at `times` (T,) [s] and `predicted` by approach; `rmse` (3,) [m] by
    approach, of the first-order model, `rmse_stokes` of Newton–Stokes.
    """

    seed: int
    session: Session
    times: np.ndarray
    measured: np.ndarray
    predicted: dict[str, np.ndarray]
    rmse: dict[str, np.ndarray]
    rmse_stokes: dict[str, np.ndarray]

    def error(self, approach: str) -> np.ndarray:
        """Return the distance (T, 3) [m] of an `approach`'s prediction from the measurement.

        Parameters
        ----------
        approach : str
            One of APPROACHES.

        Returns
        -------
        ndarray, shape (T, 3)
            Distances [m].
        """
        error: np.ndarray = np.linalg.norm(self.predicted[approach] - self.measured, axis=-1)
        return error


def record(seed: int) -> Session:
    """Simulate three particles of the paper for 15 s under straight legs, drawn by `seed`.

    Parameters
    ----------
    seed : int
        Seed of the random numbers.

    Returns
    -------
    Session
        The recording.
    """
    rng = np.random.default_rng(seed)
    made = bodies(
        FLUID, np.full(3, RADIUS), MOMENT, PHI, scatter(rng, 3, 60e-6, 30e-6),
        speed=speed_from_force(FLUID, np.full(3, RADIUS), FORCE),
        heading=rng.uniform(-math.pi, math.pi, 3))
    commands = steps(rng, DURATION, FIELD, LEGS)
    return record_session(World(made, rng), commands, CAMERA, DURATION, rng)[0]


def swimmers(force: np.ndarray, phi: np.ndarray) -> list[Particle]:
    """Return the paper's spheres with a `force` (N,) [N] and an offset `phi` (N,) [rad] each.

    Parameters
    ----------
    force : ndarray, shape (N,)
        Forces [N].
    phi : ndarray, shape (N,)
        Offsets [rad].

    Returns
    -------
    list of Particle
        One particle for each.
    """
    return [
        Particle(RADIUS, MASS, float(f), float(p), MOMENT)
        for f, p in zip(force, phi, strict=True)]


def first_order(
    particles: list[Particle], commands: Commands, times: np.ndarray, start: np.ndarray,
) -> np.ndarray:
    """Solve dp/dt = v R(φ) u, exact between commands; return positions (T, N, 2) [m].

    All solvers here start at `start` (N, 2) [m] at the first of `times` (T,) [s].

    Parameters
    ----------
    particles : list of Particle
        The N particles.
    commands : Commands
        Commands of the field.
    times : ndarray, shape (T,)
        Times [s].
    start : ndarray, shape (N, 2)
        Positions at the first time [m].

    Returns
    -------
    ndarray, shape (T, N, 2)
        Positions [m].
    """
    drag = stokes_drag(FLUID, RADIUS)
    parameters = ParticleParameters(
        np.arange(len(particles)), np.array([p.force / drag for p in particles]),
        np.array([p.phi for p in particles]))
    return simulate(Model(FIELD), parameters, commands, times, start)


def euler(
    particles: list[Particle], commands: Commands, times: np.ndarray, start: np.ndarray,
) -> np.ndarray:
    """Solve by the paper's method, Euler steps of 0.02 s, at `times` from `start`.

    Parameters
    ----------
    particles : list of Particle
        The N particles.
    commands : Commands
        Commands of the field.
    times : ndarray, shape (T,)
        Times [s].
    start : ndarray, shape (N, 2)
        Positions at the first time [m].

    Returns
    -------
    ndarray, shape (T, N, 2)
        Positions [m].
    """
    grid = np.arange(times[0], times[-1] + STEP, STEP)
    field = commands.field_at(grid[:-1])
    direction = np.arctan2(field[:, 1], field[:, 0])
    speed = np.array([p.force for p in particles]) / stokes_drag(FLUID, RADIUS)
    position = np.array(start, dtype=float)
    path = [position]
    for angle in direction:
        heading = angle + np.array([p.phi for p in particles])
        position = position + STEP * speed[:, None] * unit(heading)
        path.append(position)
    flat = np.reshape(path, (len(grid), -1))
    seen = [np.interp(times, grid, column) for column in flat.T]
    return np.transpose(seen).reshape(len(times), -1, 2)


def with_rotation(
    particles: list[Particle], commands: Commands, times: np.ndarray, start: np.ndarray,
) -> np.ndarray:
    """Solve Newton–Stokes with rotation at `times` from `start`, aligned to the first command.

    Parameters
    ----------
    particles : list of Particle
        The N particles.
    commands : Commands
        Commands of the field.
    times : ndarray, shape (T,)
        Times [s].
    start : ndarray, shape (N, 2)
        Positions at the first time [m].

    Returns
    -------
    ndarray, shape (T, N, 2)
        Positions [m].
    """
    x, y = commands.field_at(times[0])
    heading = math.atan2(y, x) + np.array([p.phi for p in particles])
    return newton_stokes(FLUID, particles, commands, times, start, heading)[0]


def stokes(
    particles: list[Particle], commands: Commands, times: np.ndarray, start: np.ndarray,
) -> np.ndarray:
    """Solve the paper's own reduction, Stokes' law, by a stiff solver at `times` from `start`.

    Parameters
    ----------
    particles : list of Particle
        The N particles.
    commands : Commands
        Commands of the field.
    times : ndarray, shape (T,)
        Times [s].
    start : ndarray, shape (N, 2)
        Positions at the first time [m].

    Returns
    -------
    ndarray, shape (T, N, 2)
        Positions [m].
    """
    return stokes_translation(FLUID, particles, commands, times, start)


Solver = Callable[[list[Particle], Commands, np.ndarray, np.ndarray], np.ndarray]
SOLVERS: dict[str, Solver] = {
    'Newton–Stokes, translation, stiff solver': stokes,
    'Newton–Stokes with rotation, stiff solver': with_rotation,
    'first-order, Euler at 0.02 s': euler,
    'first-order, exact': first_order,
}


def attempt(seed: int) -> Trial:
    """Record by `seed`, estimate F and φ from one leg, predict by every approach, compare.

    Parameters
    ----------
    seed : int
        Seed of the random numbers.

    Returns
    -------
    Trial
        The trial.
    """
    session = record(seed)
    times, measured = session.tracks.grid()
    legs = one_leg(session)
    force = np.array([force_from_speed(FLUID, RADIUS, leg.speed) for leg in legs])
    phi = np.array([leg.phi for leg in legs])
    calibrations = {
        'own': swimmers(force, phi),
        'mean': swimmers(np.full(3, force.mean()), phi),
        'true': swimmers(FORCE, PHI),
    }
    given = session.commands, times, measured[0]
    predicted = {name: first_order(c, *given) for name, c in calibrations.items()}
    return Trial(
        seed, session, times, measured, predicted,
        {name: rmse(path, measured) for name, path in predicted.items()},
        {name: rmse(stokes(c, *given), measured) for name, c in calibrations.items()})


def rmse(path: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the root-mean-square distance (N,) [m] of `path` from `measured` (T, N, 2).

    Parameters
    ----------
    path : ndarray, shape (T, N, 2)
        Predicted positions [m].
    measured : ndarray, shape (T, N, 2)
        Measured positions [m].

    Returns
    -------
    ndarray, shape (N,)
        Distances [m].
    """
    result: np.ndarray = np.sqrt(((path - measured) ** 2).sum(axis=-1).mean(axis=0))
    return result


def run_times(trial: Trial) -> dict[str, float]:
    """Return the median seconds of every solver on one trial, in turns against shared noise.

    Parameters
    ----------
    trial : Trial
        The trial.

    Returns
    -------
    dict of str to float
        Time [s] by solver.
    """
    particles = swimmers(FORCE, PHI)
    spent: dict[str, list[float]] = {name: [] for name in SOLVERS}
    for _ in range(6):
        for name, solver in SOLVERS.items():
            begin = time.perf_counter()
            solver(particles, trial.session.commands, trial.times, trial.measured[0])
            spent[name].append(time.perf_counter() - begin)
    return {name: float(np.median(times[1:])) for name, times in spent.items()}


def constants() -> dict[str, float]:
    """Return time constants [s], diffusion [m²/s] and distances [m] from the paper's numbers.

    Returns
    -------
    dict of str to float
        Values in SI by name.
    """
    speeds = speed_from_force(FLUID, np.full(3, RADIUS), FORCE)
    tau = translational_time(FLUID, RADIUS, MASS)
    return {
        'translation_s': tau,
        'rotation_s': rotational_time(FLUID, RADIUS, MASS),
        'alignment_s': alignment_time(FLUID, RADIUS, MOMENT, FIELD),
        'diffusion_m2_s': translational_diffusion(FLUID, RADIUS),
        **{f'speed_{i}_m_s': float(v) for i, v in enumerate(speeds, 1)},
        **{f'distance_{i}_m': float(v * 300 * tau) for i, v in enumerate(speeds, 1)},
    }
