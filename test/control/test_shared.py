"""The best shared displacement, by algebra and against a general optimiser."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from microbot_ros.control.contract import Workspace
from microbot_ros.control.planning.shared import (
    allowed_corners,
    as_complex,
    best_displacement,
    borders,
    floor,
    nearest_allowed,
)

VIEW = Workspace(np.array([-1.0, -0.8]), np.array([1.0, 0.8]))


def draw(seed, count):
    rng = np.random.default_rng(seed)
    position = rng.uniform(-0.7, 0.7, (count, 2))
    velocity = rng.normal(size=count) + 1j * rng.normal(size=count)
    wanted = rng.normal(size=count) + 1j * rng.normal(size=count)
    return position, velocity, wanted, complex(rng.normal(), rng.normal())


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 8))
def test_best_displacement_is_least_squares(seed, count):
    _, velocity, wanted, _ = draw(seed, count)
    expected, residual = np.linalg.lstsq(velocity[:, None], wanted, rcond=None)[:2]
    assert best_displacement(velocity, wanted) == pytest.approx(expected[0])
    if count > 1:
        assert floor(velocity, wanted) == pytest.approx(np.sqrt(residual[0].real / count))


def test_one_particle_can_go_anywhere_and_two_can_not():
    assert floor(np.array([2j]), np.array([3 + 4j])) == pytest.approx(0, abs=1e-15)
    # Alike particles asked to move apart by ±d: nothing helps.
    assert floor(np.array([1 + 1j, 1 + 1j]), np.array([5, -5])) == pytest.approx(5)


def test_nobody_and_particles_at_rest():
    assert best_displacement(np.empty(0, complex), np.empty(0, complex)) == 0
    assert floor(np.empty(0, complex), np.empty(0, complex)) == 0
    assert best_displacement(np.zeros(2, complex), np.ones(2, complex)) == 0


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_borders_say_exactly_who_would_be_outside(seed, count):
    position, velocity, _, U = draw(seed, count)
    normal, room = borders(VIEW, position, velocity, 0.05)
    ends = as_complex(position) + velocity * U
    inside = (np.abs(ends.real) <= 0.95) & (np.abs(ends.imag) <= 0.75)
    assert ((normal.conj() * U).real <= room).all() == inside.all()


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_nearest_allowed_agrees_with_an_optimiser(seed, count):
    position, velocity, _, U = draw(seed, count)
    normal, room = borders(VIEW, position, velocity, 0.05)
    found = nearest_allowed(U, normal, room)
    assert ((normal.conj() * found).real <= room + 1e-9).all()
    best = minimize(
        lambda x: abs(complex(*x) - U) ** 2, [0, 0], method='SLSQP', options={'ftol': 1e-14},
        constraints={'type': 'ineq', 'fun': lambda x: room - (normal.conj() * complex(*x)).real})
    assert abs(found - U) <= np.sqrt(best.fun) + 1e-5


def test_who_is_beyond_the_border_comes_back_if_the_others_let_it():
    answer = np.array([1 + 0j])
    normal, room = borders(VIEW, np.array([[1.2, 0.0]]), answer, 0.1)
    assert nearest_allowed(0.5 + 0j, normal, room) == pytest.approx(-0.3)
    assert nearest_allowed(-0.5 + 0j, normal, room) == pytest.approx(-0.5)
    # Two that are out on opposite sides can't both come back: nothing gets worse.
    both = borders(VIEW, np.array([[1.2, 0.0], [-1.2, 0.0]]), np.ones(2, complex), 0.1)
    assert nearest_allowed(0.5 + 0.1j, *both) == pytest.approx(0.1j)


def test_corners_of_one_particle_are_those_of_the_view():
    normal, room = borders(VIEW, np.zeros((1, 2)), np.array([1 + 0j]), 0.0)
    corners = allowed_corners(normal, room)
    expected = {complex(x, y) for x in (-1, 1) for y in (-0.8, 0.8)} | {0j}
    assert {complex(np.round(c, 12)) for c in corners} == expected
