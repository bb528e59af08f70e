"""Newton–Stokes against its closed form, against lag in closed form and against first order."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from microbot_ros.common.records import Commands
from microbot_ros.model.physics.langevin import align_heading
from microbot_ros.model.physics.newton_stokes import newton_stokes, stokes_translation
from microbot_ros.model.physics.particle import (
    Fluid,
    Particle,
    alignment_time,
    rotational_drag,
    speed_from_force,
    translational_time,
)
from microbot_ros.model.physics.vectors import unit

FLUID = Fluid(1.245e-3)
MASS, RADIUS = 4.01e-13, 4.6e-6
FORCES, PHIS = MASS * np.array([1.00, 1.18, 1.34]), np.array([-1.09, 3.82, 2.64])
START = 1e-5 * np.array([[1.0, 2.0], [0.0, -3.0], [-4.0, 0.0]])
COMMANDS = Commands(np.array([0.0, 1.0, 1.7]), 5e-3 * unit(np.array([0.3, 1.7, -2.0])))


def three(mass=MASS, moment=0.0):
    return [
        Particle(RADIUS, mass, force, phi, moment)
        for force, phi in zip(FORCES, PHIS, strict=True)]


def exact_translation(fluid, particles, commands, times, start):
    """`stokes_translation` in closed form, one exponential a leg: positions (T, N, 2) [m]."""
    radius, mass, force, phi = np.transpose([
        (p.radius, p.mass, p.force, p.phi) for p in particles])
    tau = translational_time(fluid, radius, mass)[:, None]
    edges = np.unique(np.append(commands.t, times[[0, -1]]))
    position, velocity = np.array(start, dtype=float), np.zeros((len(particles), 2))
    path = np.tile(position, (len(times), 1, 1))
    for begin, end in pairwise(edges[(edges >= times[0]) & (edges <= times[-1])]):
        x, y = commands.field_at(begin)
        ahead = unit(math.atan2(y, x) + phi) * (x != 0 or y != 0)
        steady = speed_from_force(fluid, radius, force)[:, None] * ahead
        inside = (times > begin) & (times <= end)
        t = np.append(times[inside], end)[:, None, None] - begin
        left = (velocity - steady) * np.exp(-t / tau)
        moved = position + steady * t + tau * (velocity - steady - left)
        path[inside], position, velocity = moved[:-1], moved[-1], steady + left[-1]
    return path


def test_stiff_solver_agrees_with_the_closed_form_while_the_speed_builds_up():
    times = np.concatenate((np.linspace(0, 4e-5, 41), [1.0, 1.000003, 1.00001, 2.4]))
    solved = stokes_translation(FLUID, three(), COMMANDS, times, START)
    exact = exact_translation(FLUID, three(), COMMANDS, times, START)
    assert np.abs(solved - exact).max() < 1e-14
    assert np.abs(exact[5] - START).max() > 1e-13  # it does move meanwhile


def test_what_scipy_leaves_unset_gives_no_warning(monkeypatch):
    """Memory may hold any bits, such as a NaN that signals."""
    signals = np.array(0x7ff0000000000001, np.uint64).view(float)
    odd = SimpleNamespace(**vars(np) | {'empty': lambda shape, dtype=float: np.full(
        shape, signals, dtype)})
    monkeypatch.setattr('scipy.integrate._ivp.bdf.np', odd)
    times = np.linspace(0, 2.4, 25)
    solved = stokes_translation(FLUID, three(), COMMANDS, times, START)
    assert np.isfinite(solved).all()


def test_rotating_with_a_strong_moment_is_translation_alone():
    times = np.linspace(0, 2.4, 25)
    moment = rotational_drag(FLUID, RADIUS) / (1e-5 * 5e-3)
    start_heading = 0.3 + PHIS
    path, _ = newton_stokes(FLUID, three(moment=moment), COMMANDS, times, START, start_heading)
    reduced = stokes_translation(FLUID, three(), COMMANDS, times, START)
    assert np.abs(path - reduced).max() < 5e-10  # v·τ_align a switch: 5e-6 · 1e-5 · a few


def test_heading_turns_on_the_overdamped_time_not_on_the_inertial_one():
    """With 0.2 s to align, inertia (1 µs) is nowhere to be seen in the heading."""
    moment = rotational_drag(FLUID, RADIUS) / (0.2 * 5e-3)
    particles = three(moment=moment)
    times = np.array([0.0, 0.1, 0.3, 0.9])
    _, heading = newton_stokes(FLUID, particles, COMMANDS, times, START, np.zeros(3))
    tau = alignment_time(FLUID, RADIUS, moment, 5e-3)
    expected = [[align_heading(0.0, 0.3 + phi, t / tau) for phi in PHIS] for t in times]
    assert heading == pytest.approx(np.array(expected), abs=2e-5)


def test_without_a_field_nothing_propels_what_follows_at_once():
    commands = Commands(np.array([0.5]), np.array([[5e-3, 0.0]]))
    times = np.array([0.0, 0.4, 0.9])
    for method in (stokes_translation, exact_translation):
        path = method(FLUID, three(), commands, times, START)
        assert np.array_equal(path[1], START)
        assert np.abs(path[2] - START).max() > 1e-6
