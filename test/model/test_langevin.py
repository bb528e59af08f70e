"""Headings in noise against closed-form statistics, within their sampling intervals."""

import math

import numpy as np
import pytest
from scipy import stats

from bench._langevin import simulate_langevin
from microbot_ros.common.records import Commands
from microbot_ros.model.physics.langevin import align_heading, step_grid
from microbot_ros.model.physics.particle import (
    Fluid,
    Particle,
    rotational_diffusion,
    rotational_drag,
)

FLUID = Fluid(viscosity=1e-3, temperature=300.0)
SMALL = Particle(radius=0.5e-6, mass=5e-16, force=0.0)
NOTHING = Commands(np.array([0.0]), np.zeros((1, 2)))


def run(particle, commands, times, seed, count=2000, **start):
    return simulate_langevin(
        FLUID, [particle] * count, commands, np.asarray(times), np.random.default_rng(seed),
        **start)


def along_x(field):
    return Commands(np.array([0.0]), np.array([[field, 0.0]]))


def moment_for(rate_per_diffusion, field):
    """The moment that aligns at so many times the rotational diffusion."""
    rate = rate_per_diffusion * rotational_diffusion(FLUID, SMALL.radius)
    return rate * rotational_drag(FLUID, SMALL.radius) / field


def test_heading_memory_decays_at_the_rotational_diffusion():
    decay = rotational_diffusion(FLUID, SMALL.radius)
    times = np.array([0.0, 0.1, 0.3, 0.6])
    path = run(SMALL, NOTHING, times, seed=2, heading=np.zeros(2000))
    for t, heading in zip(times[1:], path.heading[1:], strict=True):
        cosines = np.cos(heading)
        error = cosines.std(ddof=1) / math.sqrt(len(cosines))
        assert abs(cosines.mean() - math.exp(-decay * t)) < 4 * error


@pytest.mark.parametrize('concentration', [0.5, 3.0, 40.0])
def test_stationary_heading_in_a_field_is_von_mises(concentration):
    particle = Particle(
        SMALL.radius, SMALL.mass, force=0.0, phi=0.7, moment=moment_for(concentration, 1e-3))
    path = run(particle, along_x(1e-3), [0.0, 2.0], seed=3)
    error = (path.heading[-1] - 0.7 + math.pi) % (2 * math.pi) - math.pi
    assert stats.kstest(error, stats.vonmises(concentration).cdf).pvalue > 1e-3


def test_stiff_alignment_keeps_the_boltzmann_spread():
    """A heading that aligns in a fiftieth of a step still spreads by D_r/κ, as kT demands."""
    particle = Particle(
        SMALL.radius, SMALL.mass, force=0.0, moment=moment_for(50_000.0, 1e-3))
    path = run(particle, along_x(1e-3), [0.0, 0.05], seed=4)
    heading = path.heading[-1]
    error = (heading + math.pi) % (2 * math.pi) - math.pi
    low, high = stats.chi2(len(error)).interval(0.999)
    assert low < (error**2).sum() * 50_000 < high


def test_alignment_is_the_exact_solution():
    from scipy.integrate import solve_ivp

    for start in (-3.0, -1.0, 0.3, 2.9):
        solved = solve_ivp(
            lambda _, y: 2.0 * np.sin(0.4 - y), (0, 1.5), [start], rtol=1e-11, atol=1e-12)
        assert align_heading(start, 0.4, 3.0) == pytest.approx(solved.y[0, -1], abs=1e-9)
    assert align_heading(1.0, 1.0 + 2 * math.pi, 5.0) == pytest.approx(1.0)
    assert align_heading(0.3, 2.0, 0.0) == pytest.approx(0.3)


@pytest.mark.parametrize(('span', 'count'), [(1e-3, 1), (1 / 60, 17), (0.25e-3, 1), (1.0, 1000)])
def test_steps_fill_the_interval(span, count):
    middle, length = step_grid(2.0, 2.0 + span)
    assert len(middle) == count
    assert length * count == pytest.approx(span)
    assert middle[0] == pytest.approx(2.0 + length / 2)
    assert middle[-1] == pytest.approx(2.0 + span - length / 2)
