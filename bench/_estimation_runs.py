"""Simulated experiments with known truth for the estimators: fine Langevin physics, filmed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.estimation.batch import fit
from microbot_ros.estimation.commands import model_paths
from microbot_ros.estimation.noise import GainLikelihood
from microbot_ros.estimation.online import Estimates, Estimator
from microbot_ros.estimation.recipe import one_leg
from microbot_ros.model.model import Model
from microbot_ros.model.particle import Fluid, translational_diffusion
from microbot_ros.records import Conditions, Session
from microbot_ros.virtual_rig.commands import Herding, steps
from microbot_ros.virtual_rig.experiment import Camera, draw_swarm, perform
from microbot_ros.virtual_rig.world import World

FIELD = 5e-3
FLUID = Fluid(1.245e-3)
RADIUS = 4.6e-6
DIFFUSION = translational_diffusion(FLUID, RADIUS)


@dataclass(frozen=True)
class Run:
    """One recording with its truth: c (N,) complex, σ [m] and exposure [s]."""

    session: Session
    gain: np.ndarray
    sigma: float
    exposure: float


def record(seed: int, duration: float = 30.0, particles: int = 3) -> Run:
    """An experiment drawn by `seed`: noise level, gaps, shutter, frame rate, kind of command.

    Spheres that touch push each other, which the first-order model does not know: an experiment
    in which two come that close is drawn again.
    """
    for attempt in range(100):
        run, path = _draw(np.random.default_rng([seed, attempt]), seed % 2 == 0, duration,
                          particles)
        gap = path[:, :, None] - path[:, None] + 1e9 * np.eye(particles)[..., None]
        if np.hypot(gap[..., 0], gap[..., 1]).min() > 2.3 * RADIUS:
            return run
    raise RuntimeError(f'experiment {seed} always ends in contact')


def _draw(
    rng: np.random.Generator, closed: bool, duration: float, particles: int,
) -> tuple[Run, np.ndarray]:
    sigma = float(rng.choice([0.03e-6, 0.1e-6, 0.3e-6]))
    rate = float(rng.choice([20.0, 30.0, 60.0]))
    shutter = float(rng.choice([0.0, 1.0]))
    missed = float(rng.choice([0.0, 0.1]))
    swarm = draw_swarm(rng, particles, FLUID, FIELD)
    truth = swarm['speed'] * np.exp(1j * swarm['phi'])
    control = (
        Herding(swarm['phi'].copy(), FIELD) if closed
        else steps(rng, duration, FIELD, (1.0, 4.0))
    )
    camera = Camera(rate, shutter, sigma, missed, run=3.0, dropped=missed / 5)
    conditions = Conditions(radius=RADIUS, viscosity=FLUID.viscosity, reference_field=FIELD)
    session, path = perform(World(swarm, rng), control, camera, duration, rng, conditions)
    return Run(session, truth, sigma, shutter / rate), path.position


def replay(run: Run, estimator: Estimator | None = None) -> list[Estimates]:
    """The online estimator over a recording, command by command, frame by frame."""
    from microbot_ros.estimation.online import Settings

    session = run.session
    if estimator is None:
        estimator = Estimator(session.conditions, Settings(exposure=run.exposure))
    times, positions = session.tracks.grid()
    commands, sent, out = session.commands, 0, []
    ids = session.tracks.particles
    for t, position in zip(times, positions, strict=True):
        while sent < len(commands.t) and commands.t[sent] <= t:
            estimator.command(commands.t[sent], commands.field[sent])
            sent += 1
        seen = np.isfinite(position[:, 0])
        out.append(estimator.update(float(t), ids[seen], position[seen]))
    return out


def bound(run: Run) -> np.ndarray:
    """Cramér–Rao bound on c (N,), per axis [m/s], with noise levels known."""
    times, positions = run.session.tracks.grid()
    z = positions[..., 0] + 1j * positions[..., 1]
    model = Model.baseline(run.session.conditions, run.session.commands)
    path = model_paths(model, run.session.commands, times).drive
    power = GainLikelihood(times, z, np.broadcast_to(path, z.shape), run.exposure).at(
        run.sigma**2 / DIFFUSION
    ).power
    return np.sqrt(DIFFUSION / power)
