"""The first-order integrator and the increments that fits evaluate thousands of times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.figure import Figure, seconds
from microbot_ros.common.records import Commands
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.first_order import simulate
from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.timeline import Timeline

_FIELD = 2e-3


def _commands(rng: np.random.Generator, seconds_long: float) -> Commands:
    """Legs of 2 to 6 s, as in the paper."""
    t = np.cumsum(rng.uniform(2.0, 6.0, int(seconds_long)))
    t = np.concatenate([[0.0], t[t < seconds_long]])
    angle = rng.uniform(-np.pi, np.pi, len(t))
    return Commands(t, _FIELD * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _particles(rng: np.random.Generator, count: int) -> ParticleParameters:
    return ParticleParameters(
        np.arange(count), rng.uniform(3e-6, 6e-6, count), rng.uniform(-np.pi, np.pi, count))


def _euler(particles: ParticleParameters, commands: Commands, times: np.ndarray,
           start: np.ndarray) -> np.ndarray:
    """dp/dt = v R(φ) u stepped from frame to frame, NumPy over the particles."""
    tracks = np.empty((len(times), *start.shape))
    tracks[0] = p = start
    for k, h in enumerate(np.diff(times)):
        bx, by = commands.field_at(times[k])
        theta = np.arctan2(by, bx) + particles.phi
        velocity = particles.speed[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=1)
        tracks[k + 1] = p = p + h * velocity
    return tracks


def _trajectories() -> Figure:
    rng = np.random.default_rng(1)
    commands, particles = _commands(rng, 15.0), _particles(rng, 1000)
    times, start = np.linspace(0.0, 15.0, 750), rng.normal(0, 1e-4, (1000, 2))
    model = Model(_FIELD)
    ours, euler = seconds(
        lambda: simulate(model, particles, commands, times, start),
        lambda: _euler(particles, commands, times, start),
    )
    apart = np.abs(simulate(model, particles, commands, times, start)
                   - _euler(particles, commands, times, start)).max()
    # Euler learns of a switch one step late: all that the two may differ by.
    same = apart <= 2 * len(commands.t) * particles.speed.max() * (times[1] - times[0])
    return Figure(3, 'first-order, 1,000 particles × 750 steps, against Euler', euler / ours, '×',
                  '≥ 5', 'plain NumPy Euler', bool(same and euler / ours >= 5))


def _increments() -> list[Figure]:
    rng = np.random.default_rng(2)
    times = np.arange(1800) / 30
    timeline = Timeline(_commands(rng, 60.0), times)
    particles = _particles(rng, 4)
    algebraic = Model(_FIELD, effects=(BackgroundField(1e-4, 2e-4),))
    lag = Model(_FIELD, effects=(AlignmentLag(0.2),))
    spent = seconds(
        lambda: respond(algebraic, timeline).increments(particles),
        lambda: respond(lag, timeline).increments(particles), rounds=31,
    )
    return [
        Figure(3, f'increments of 4 particles × 1,800 frames, {name}', 1e3 * time, 'ms',
               f'≤ {limit}', '–', time <= 1e-3 * limit)
        for name, time, limit in zip(('background field', 'alignment lag'), spent, (5, 10),
                                     strict=True)
    ]


def figures() -> Iterator[Figure]:
    """The figures of the model."""
    yield _trajectories()
    yield from _increments()
