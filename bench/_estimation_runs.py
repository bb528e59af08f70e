"""Simulated experiments with known truth for the estimators: fine Langevin physics, filmed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from microbot_ros.common.records import Conditions, Session, Tracks
from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import SessionFit, Whitening
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.estimation.online.estimator import Estimates, Estimator, Settings
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.particle import Fluid, translational_diffusion
from microbot_ros.session import read_session
from microbot_ros.virtual_rig.commands import Herding, steps
from microbot_ros.virtual_rig.record_session import Camera, as_tracks, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

FIELD = 5e-3
FLUID = Fluid(1.245e-3)
RADIUS = 4.6e-6
DIFFUSION = translational_diffusion(FLUID, RADIUS)


@dataclass(frozen=True)
class Run:
    """One recording with its truth: c (N,) complex, σ [m] and exposure [s]."""

    session: Session
    velocity_phasor: np.ndarray
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
    rate = float(rng.choice([10.0, 20.0, 30.0]))
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
    session, path = record_session(World(swarm, rng), control, camera, duration, rng, conditions)
    return Run(session, truth, sigma, shutter / rate), path.position


def replay(run: Run) -> list[Estimates]:
    """The online estimator over a recording, command by command, frame by frame."""
    session = run.session
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
    return np.sqrt(DIFFUSION / _known_noise(run, -np.inf, np.inf).power)


def told_of_change(run: Run, begin: float, end: float) -> np.ndarray:
    """c (N,) from what was seen between two times [s] alone, with noise levels known."""
    return _known_noise(run, begin, end).velocity_phasor


def _known_noise(run: Run, begin: float, end: float) -> SessionFit:
    session = PreparedSession.of(run.session)
    kept = session.only((session.times >= begin) & (session.times <= end))
    model = Model.baseline(run.session.conditions, run.session.commands)
    whitening = Whitening(run.sigma**2 / DIFFUSION - run.exposure / 3)
    return SessionFit.of(kept, whitening, ExpectedDisplacement.of(model, kept.timeline))


def record_change(seed: int, factor: complex, changed: float = 20.0) -> tuple[Run, float]:
    """An experiment in which every c is multiplied by `factor` at `changed` [s]; c afterwards.

    The world of fine Langevin steps before and after, with a turn of the field every second.
    """
    rng = np.random.default_rng([seed, 77])
    swarm = draw_swarm(rng, 3, FLUID, FIELD, half_extent=200e-6, spacing=60e-6)
    commands = steps(rng, changed + 4.0, FIELD, (0.8, 1.2))
    world = World(swarm, rng)
    camera = Camera(30.0, 0.0, 0.1e-6)
    conditions = Conditions(radius=RADIUS, viscosity=FLUID.viscosity, reference_field=FIELD)
    first, _ = record_session(world, commands, camera, changed, rng, conditions)
    later = swarm.copy()
    later['x'], later['y'] = world.position.T
    later['heading'] = world.heading
    later['speed'] *= abs(factor)
    later['phi'] += np.angle(factor)
    after = replace(commands, t=commands.t - changed)
    second, _ = record_session(World(later, rng), after, camera, 4.0, rng, conditions)
    session = replace(first, tracks=_joined(first.tracks, second.tracks, changed))
    truth = later['speed'] * np.exp(1j * later['phi'])
    return Run(session, truth, 0.1e-6, 0.0), changed


def _joined(first: Tracks, second: Tracks, later: float) -> Tracks:
    early = first.t < later - 1e-9
    return Tracks(
        np.concatenate([first.t[early], second.t + later]),
        np.concatenate([first.particle[early], second.particle]),
        np.concatenate([first.position[early], second.position]),
        np.concatenate([first.theta[early], second.theta]),
        np.concatenate([first.sigma[early], second.sigma]),
    )


def quiet_hours(seed: int, hours: float = 2.0, rate: float = 5.0) -> int:
    """How often the diagnosis speaks up, other than on excitation, on data from the model."""
    rng = np.random.default_rng([seed, 5])
    times = np.arange(int(hours * 3600 * rate)) / rate
    commands = steps(rng, times[-1], FIELD, (1.0, 5.0))
    particles = ParticleParameters(
        np.arange(3), rng.uniform(3.5e-6, 5e-6, 3), rng.uniform(-np.pi, np.pi, 3))
    truth = simulate(Model(FIELD), particles, commands, times, 1e-4 * rng.normal(size=(3, 2)))
    truth += np.sqrt(2 * DIFFUSION / rate) * np.cumsum(rng.normal(size=truth.shape), axis=0)
    tracks = as_tracks(times, truth + 0.1e-6 * rng.normal(size=truth.shape))
    conditions = Conditions(radius=RADIUS, viscosity=FLUID.viscosity, reference_field=FIELD)
    alarms, standing = 0, set[str]()
    for estimates in replay(Run(Session(tracks, commands, conditions), particles.velocity_phasor,
                                0.1e-6, 0.0)):
        now = {text for text in estimates.diagnosis if 'cannot be told apart' not in text}
        alarms += bool(now - standing)
        standing = now
    return alarms


def rolling_robot() -> Session | None:
    """The recording of a rolling robot beside the checkout; None, with a word, where absent."""
    folder = Path(__file__).parents[2] / 'shared' / 'data' / 'rolling_robot'
    if not folder.is_dir():
        print(f'no {folder}: the rolling robot is left out')
        return None
    return read_session(folder)
