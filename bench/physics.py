"""The finer physics: Newton–Stokes against first order, Langevin against the clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from bench._langevin import simulate_langevin
from bench.figure import Figure, seconds
from microbot_ros.common.records import Commands
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.particle import Fluid, Particle, rotational_drag, speed_from_force
from microbot_ros.paper import repetition as paper

_CALLS = 50


def _first_order() -> list[Figure]:
    """The paper's comparison, on its own experiment: 15 s, three particles, four or so legs.

    The moments align the particles within 10 µs, as the paper has it: with a real lag the two
    models differ by physics, and no RMSE would agree.
    """
    session = paper.record(1)
    times, measured = session.tracks.grid()
    moment = rotational_drag(paper.FLUID, paper.RADIUS) / (1e-5 * paper.FIELD)
    swimmers = [replace(s, moment=moment) for s in paper.swimmers(paper.FORCE, paper.PHI)]
    model = Model(paper.FIELD)
    particles = ParticleParameters(
        np.arange(3), speed_from_force(paper.FLUID, np.full(3, paper.RADIUS), paper.FORCE),
        paper.PHI)
    given = session.commands, times, measured[0]

    def first_order() -> np.ndarray:
        return simulate(model, particles, *given)

    def newton_stokes() -> np.ndarray:
        return paper.with_rotation(swimmers, *given)

    def translation() -> np.ndarray:
        return paper.stokes(swimmers, *given)

    # Microseconds against a tenth of a second: one call alone would time the cold cache.
    many, full, part = seconds(
        lambda: [first_order() for _ in range(_CALLS)], newton_stokes, translation)
    error = paper.rmse(first_order(), measured)

    def figure(name: str, run: Callable[[], np.ndarray], spent: float, target: float) -> Figure:
        same = np.allclose(error, paper.rmse(run(), measured), rtol=5e-4)
        ratio = spent * _CALLS / many
        return Figure(
            3, f'first-order, 15 s of three particles, same RMSE to 3 digits, against {name}',
            ratio, '×', f'≥ {target:g}', 'SciPy solve_ivp, BDF', bool(same and ratio >= target))

    return [
        figure('Newton–Stokes', newton_stokes, full, 300),
        figure('its translation alone (in the paper 1.04)', translation, part, 300),
    ]


def _langevin() -> Figure:
    rng = np.random.default_rng(1)
    fluid = Fluid(1.245e-3)
    swimmers = [
        Particle(4.6e-6, 4e-13, 4e-13, phi, 4e-13) for phi in rng.uniform(-np.pi, np.pi, 1000)]
    commands = Commands(np.array([0.0, 0.4]), np.array([[5e-3, 0.0], [0.0, 5e-3]]))
    times = np.linspace(0.0, 1.0, 31)
    (spent,) = seconds(lambda: simulate_langevin(fluid, swimmers, commands, times, rng))
    return Figure(3, 'Langevin, 1,000 particles, 1 ms steps, against real time', 1 / spent, '×',
                  '≥ 1', 'the clock', spent <= 1)


def figures() -> Iterator[Figure]:
    """Every figure of the physics."""
    yield from _first_order()
    yield _langevin()
