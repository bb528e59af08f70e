"""Brownian motion against its closed-form statistics, within their sampling intervals."""

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
    speed_from_force,
    translational_diffusion,
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


def test_mean_squared_displacement_is_four_d_t():
    path = run(SMALL, NOTHING, [0.0, 0.1, 0.2], seed=1)
    diffusion = translational_diffusion(FLUID, SMALL.radius)
    for t, moved in zip(path.t[1:], path.position[1:], strict=True):
        # Σ r² / 2Dt is chi-squared with two degrees of freedom a particle.
        low, high = stats.chi2(2 * len(moved)).interval(0.999)
        assert low < (moved**2).sum() / (2 * diffusion * t) < high


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


def test_active_diffusion_of_a_free_swimmer():
    """⟨r²⟩ = 4Dt + 2v²/D_r² (D_r t − 1 + exp(−D_r t)) (Howse et al., 2007)."""
    particle = Particle(SMALL.radius, SMALL.mass, force=1e-13)
    speed = speed_from_force(FLUID, particle.radius, particle.force)
    decay = rotational_diffusion(FLUID, particle.radius)
    diffusion = translational_diffusion(FLUID, particle.radius)
    path = run(particle, NOTHING, [0.0, 2.0], seed=5)
    squares = (path.position[-1] ** 2).sum(axis=-1)
    expected = 8 * diffusion + 2 * (speed / decay) ** 2 * (
        2 * decay - 1 + math.exp(-2 * decay))
    error = squares.std(ddof=1) / math.sqrt(len(squares))
    assert abs(squares.mean() - expected) < 4 * error


def test_swims_along_the_field_turned_by_phi():
    particle = Particle(4.6e-6, 4e-13, force=4e-13, phi=1.2, moment=1e-11)
    path = run(particle, along_x(5e-3), [0.0, 0.5, 10.5], seed=6, count=50)
    speed = speed_from_force(FLUID, particle.radius, particle.force)
    velocity = (path.position[2] - path.position[1]) / 10
    spread = math.sqrt(2 * translational_diffusion(FLUID, 4.6e-6) / 10 / 50)
    expected = speed * np.array([math.cos(1.2), math.sin(1.2)])
    assert np.all(np.abs(velocity.mean(axis=0) - expected) < 4.5 * spread)


def test_alignment_is_the_exact_solution():
    from scipy.integrate import solve_ivp

    for start in (-3.0, -1.0, 0.3, 2.9):
        solved = solve_ivp(
            lambda _, y: 2.0 * np.sin(0.4 - y), (0, 1.5), [start], rtol=1e-11, atol=1e-12)
        assert align_heading(start, 0.4, 3.0) == pytest.approx(solved.y[0, -1], abs=1e-9)
    assert align_heading(1.0, 1.0 + 2 * math.pi, 5.0) == pytest.approx(1.0)
    assert align_heading(0.3, 2.0, 0.0) == pytest.approx(0.3)


def test_halving_the_steps_changes_nothing_beyond_chance():
    """One run of 1 ms steps and one of 0.2 ms steps are the same distribution."""
    particle = Particle(
        SMALL.radius, SMALL.mass, force=2e-13, moment=moment_for(20.0, 1e-3))
    commands = Commands(np.array([0.0, 0.1]), np.array([[1e-3, 0.0], [0.0, 1e-3]]))
    start = {'heading': np.zeros(2000)}
    coarse = run(particle, commands, [0.0, 0.2], seed=7, **start).position[-1]
    fine = run(particle, commands, np.linspace(0, 0.2, 1001), seed=8, **start).position[-1]
    for axis in (0, 1):
        assert stats.ks_2samp(coarse[:, axis], fine[:, axis]).pvalue > 1e-3


def test_same_seed_same_path():
    first, second = (run(SMALL, NOTHING, [0.0, 0.05], seed=9, count=3) for _ in range(2))
    assert np.array_equal(first.position, second.position)
    assert np.array_equal(first.heading, second.heading)


@pytest.mark.parametrize(('span', 'count'), [(1e-3, 1), (1 / 60, 17), (0.25e-3, 1), (1.0, 1000)])
def test_steps_fill_the_interval(span, count):
    middle, length = step_grid(2.0, 2.0 + span)
    assert len(middle) == count
    assert length * count == pytest.approx(span)
    assert middle[0] == pytest.approx(2.0 + length / 2)
    assert middle[-1] == pytest.approx(2.0 + span - length / 2)
