"""Field and pull together, against the gradient itself and independent solvers."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from coil_rigs import EIGHT, SIX, scattered
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, minimize

from microbot_ros.common.errors import InputError
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings

seeds = st.integers(0, 2**32 - 1)


@cache
def some_coils(rig: int) -> CoilSet:
    """One of five rigs with eight to fourteen coils."""
    return CoilSet(EIGHT) if rig == 0 else scattered(rig, 6 + 2 * rig)


def drawn(seed: int, axes: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A field [T] of 1 mT and a pull [T/m] of 10 mT/m, each anywhere."""
    field, pull = np.random.default_rng(seed).normal(size=(2, axes))
    return 1e-3 * field / np.linalg.norm(field), 1e-2 * pull / np.linalg.norm(pull)


def rows(coils: CoilSet, field: np.ndarray) -> np.ndarray:
    """Field and pull per ampere (6, N), by differences of the field of each coil."""
    step, unit = 1e-5, field / np.linalg.norm(field)
    ahead, behind = coils.field_per_ampere([step * unit, -step * unit]).swapaxes(0, 1)
    return np.vstack([coils.actuation_matrix(), ((ahead - behind) / (2 * step)).T])


@settings(max_examples=40)
@given(seeds, st.integers(0, 4))
def test_both_are_made_as_cheaply_as_can_be(seed, rig):
    coils = some_coils(rig)
    field, pull = drawn(seed)
    found = Allocator(coils).actuate(field, pull)
    assume(not found.saturated)
    made = rows(coils, field)
    np.testing.assert_allclose(made[:3] @ found.currents + coils.background, field, atol=1e-13)
    np.testing.assert_allclose(made[3:] @ found.currents, pull, atol=1e-7)
    np.testing.assert_allclose(found.field, field, atol=1e-13)
    np.testing.assert_allclose(found.pull, pull, atol=1e-11)
    assert found.power == pytest.approx(coils.power(found.currents))
    root = np.sqrt(coils.resistance)
    without = np.linalg.pinv(made / root) @ np.concatenate([field - coils.background, pull]) / root
    if (np.abs(without) <= coils.max_current).all():
        np.testing.assert_allclose(found.currents, without, atol=1e-6)


def test_limits_are_met_exactly_and_no_better_point_is_found_by_another_solver():
    coils, bound = CoilSet(EIGHT), 0
    allocator = Allocator(coils)
    for seed in range(8):
        field, pull = (5 * part for part in drawn(seed))
        made = rows(coils, field) * np.repeat([1e3, 1e2], 3)[:, None]
        wanted = np.concatenate([1e3 * field, 1e2 * pull])
        # The part of both that is in reach, then a little less than that.
        part = -linprog(np.append(np.zeros(8), -1.0), A_eq=np.column_stack([made, -wanted]),
                        b_eq=np.zeros(6), bounds=[*[(-5, 5)] * 8, (0, None)]).fun
        beyond = allocator.actuate(2 * part * field, 2 * part * pull)
        assert beyond.saturated
        assert np.abs(beyond.currents).max() <= 5
        np.testing.assert_allclose(beyond.field, part * field, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(beyond.pull, part * pull, rtol=1e-6, atol=1e-8)
        found = allocator.actuate(0.97 * part * field, 0.97 * part * pull)
        assert not found.saturated
        bound += bool((np.abs(found.currents) == 5).any())
        other = minimize(
            coils.power, found.currents * 0.5, method='SLSQP', bounds=[(-5, 5)] * 8,
            jac=lambda currents: 2 * coils.resistance * currents, constraints=[{
                'type': 'eq', 'jac': lambda _, made=made: made,
                'fun': lambda currents, made=made, goal=0.97 * part * wanted:
                made @ currents - goal}], options={'ftol': 1e-9, 'maxiter': 1000})
        assert other.success
        assert found.power == pytest.approx(other.fun, rel=1e-5)
    assert bound >= 2


def test_pulls_that_coils_cannot_make_are_named():
    square, field = Allocator(CoilSet()), np.array([1e-3, 0.0])
    # Crossed pairs have no ∂By/∂x at the centre: under a field along x nothing pulls along y.
    with pytest.raises(InputError, match=r'coils: no pull along y \(0.00, 1.00, 0.00\) under a '
                       r'field along x \(1.00, 0.00, 0.00\)'):
        square.actuate(field, (0, 1e-3))
    found = square.actuate(field, (1e-3, 0))
    np.testing.assert_allclose(found.pull, (1e-3, 0), atol=1e-15)
    oblique = square.actuate((1e-3, 1e-3), (0, 1e-3))
    np.testing.assert_allclose(oblique.pull, (0, 1e-3), atol=1e-15)
    # Three pairs make G = diag(p, q, −p − q) only: Σ fᵢ/bᵢ = 0 for every pull.
    with pytest.raises(InputError, match=r'no pull along \(0.67, 0.33, -0.67\) under'):
        Allocator(CoilSet(SIX)).actuate((1e-3, 2e-3, -1e-3), (1e-3, 1e-3, 1e-3))
    along = np.array([1.0, -2.0, 0.0]) * 1e-3
    np.testing.assert_allclose(
        Allocator(CoilSet(SIX)).actuate((1e-3, 2e-3, -1e-3), along).pull, along, atol=1e-15)


def test_every_field_of_the_eight_coils_bears_every_pull():
    allocator = Allocator(CoilSet(EIGHT))
    for seed in range(100):
        field, pull = drawn(seed)
        assert not allocator.actuate(field, 0.1 * pull).saturated


def test_a_moment_needs_a_field_and_the_background_is_taken_off():
    with pytest.raises(ValueError, match='not zero'):
        Allocator(CoilSet(EIGHT)).actuate((0, 0, 0), (1e-3, 0, 0))
    coils = CoilSet(EIGHT.replaced(background_mT=(0.05, -0.02, 0.04)))
    field, pull = drawn(3)
    for scale in (1, 100):
        found = Allocator(coils).actuate(scale * field, scale * pull)
        assert found.saturated == (scale == 100)
        size = np.linalg.norm(found.field) / np.linalg.norm(field)
        np.testing.assert_allclose(found.field, size * field, rtol=1e-8)
        np.testing.assert_allclose(found.pull, size * pull, rtol=1e-7)
    strong = CoilSettings(background_mT=(4.2, 0.0))
    assert Allocator(CoilSet(strong)).actuate((4.2e-3, 1e-4), (0, 0)).power < 0.1
