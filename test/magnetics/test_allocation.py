"""Currents of 2 to 16 coils along two axes and three, against the conditions for the least power
and linear programmes.
"""

from __future__ import annotations

import numpy as np
import pytest
from coil_rigs import EIGHT, SIX, scattered
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from microbot_ros.common.errors import InputError
from microbot_ros.common.units import MU_0
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings

magpylib = pytest.importorskip('magpylib')


def usable(coils: CoilSet, point: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Allocator:
    """An allocator of coils that are not so badly placed as to be good for nothing."""
    matrix = coils.actuation_matrix(point)[:coils.axes]
    inverse = np.linalg.pinv(matrix)
    assume(np.linalg.cond(matrix) < 100)
    assume((np.abs(inverse @ coils.background) < coils.max_current).all())
    return Allocator(coils, point)


rigs = st.one_of(
    st.tuples(st.integers(0, 2**32 - 1), st.integers(2, 16), st.just('xy')),
    st.tuples(st.integers(0, 2**32 - 1), st.integers(3, 16), st.just('xyz')),
).map(lambda drawn: scattered(*drawn))
seeds = st.integers(0, 2**32 - 1)


def unit(seed: int, axes: int) -> np.ndarray:
    direction = np.random.default_rng(seed).normal(size=axes)
    return direction / np.linalg.norm(direction)


def largest_by_linprog(coils: CoilSet, matrix: np.ndarray, direction: np.ndarray) -> float:
    found = linprog(
        np.append(np.zeros(len(coils.names)), -1.0),
        A_eq=np.column_stack([1e3 * matrix, -direction]), b_eq=-1e3 * coils.background,
        bounds=[*((-limit, limit) for limit in coils.max_current), (0, None)])
    return 1e-3 * found.x[-1]


def waste(coils: CoilSet, columns: np.ndarray, currents: np.ndarray) -> float:
    """How far currents are from the conditions for the least power (Karush, Kuhn, Tucker), 0 to 1.

    A price λ must exist for each component of the field such that 2RI = aᵀλ for coils off their
    limits and |aᵀλ| ≥ 2RI, same sign, for coils at them. A linear programme finds the λ that fails
    least.
    """
    slope, (count, prices) = 2 * coils.resistance * currents, columns.shape
    columns = columns / np.abs(columns).max(axis=0)
    upper = currents >= coils.max_current * (1 - 1e-9)
    lower = currents <= -coils.max_current * (1 - 1e-9)
    rows, bounds = [], []
    for sign, spared in ((1, upper), (-1, lower)):
        rows.append(np.column_stack([sign * columns, -np.ones(count)])[~spared])
        bounds.append((sign * slope)[~spared])
    found = linprog(np.append(np.zeros(prices), 1.0), np.vstack(rows), np.concatenate(bounds),
                    bounds=[*[(None, None)] * prices, (0, None)])
    return found.fun / np.abs(slope).max()


@settings(max_examples=80)
@given(rigs, seeds, st.floats(0.01, 0.999), st.sampled_from([(0, 0, 0), (1e-3, -2e-3, 0)]))
def test_field_in_reach_is_made_exactly_and_as_cheaply_as_can_be(coils, seed, part, point):
    allocator = usable(coils, point)
    direction = unit(seed, coils.axes)
    wanted = part * allocator.largest(direction) * direction
    found = allocator.allocate(wanted)
    assert not found.saturated
    assert (np.abs(found.currents) <= coils.max_current).all()
    np.testing.assert_allclose(found.field, wanted, rtol=1e-8, atol=1e-12)
    made = coils.field(found.currents, [point])[0, :coils.axes] + coils.background
    np.testing.assert_allclose(made, wanted, rtol=1e-8, atol=1e-12)
    assert found.power == pytest.approx(coils.power(found.currents))
    assert waste(coils, allocator.matrix.T, found.currents) < 1e-6


def test_waste_is_seen():
    coils = scattered(0, 4, 'xy')
    allocator = Allocator(coils)
    spare = np.linalg.svd(allocator.matrix)[2][2]
    found = allocator.allocate((1e-3, 2e-4)).currents
    assert waste(coils, allocator.matrix.T, found) < 1e-6
    assert waste(coils, allocator.matrix.T, found + 1e-3 * spare) > 1e-4


@settings(max_examples=80)
@given(rigs, seeds, st.floats(1.0001, 1e6))
def test_field_out_of_reach_keeps_direction_and_the_most_there_is(coils, seed, beyond):
    allocator = usable(coils)
    direction = unit(seed, coils.axes)
    largest = largest_by_linprog(coils, allocator.matrix, direction)
    found = allocator.allocate(beyond * largest * direction)
    assert found.saturated
    assert (np.abs(found.currents) <= coils.max_current).all()
    assert allocator.largest(7 * direction) == pytest.approx(largest, rel=1e-7)
    np.testing.assert_allclose(found.field, largest * direction, atol=1e-7 * largest)


@pytest.mark.parametrize('seed', range(40))
@pytest.mark.parametrize('axes', ['xy', 'xyz'])
def test_at_the_very_edge_of_what_can_be_reached_no_digit_is_lost(seed, axes):
    coils = scattered(seed, 3 + seed % 14, axes)
    allocator = Allocator(coils)
    for direction in (*np.eye(len(axes)), unit(seed, len(axes))):
        largest = allocator.largest(direction)
        for wanted in (largest, 50 * largest):
            found = allocator.allocate(wanted * direction)
            np.testing.assert_allclose(found.field, largest * direction, atol=1e-9 * largest)
            assert (np.abs(found.currents) <= coils.max_current).all()


def test_helmholtz_pairs_make_what_the_textbook_says():
    coils, allocator = CoilSet(SIX), Allocator(CoilSet(SIX))
    assert coils.axes == 3
    for axis, (turns, radius, names) in enumerate([
            (250, 0.05, ('coil_plus_x', 'coil_minus_x')),
            (200, 0.04, ('coil_plus_y', 'coil_minus_y')),
            (300, 0.06, ('coil_plus_z', 'coil_minus_z'))]):
        per_ampere = 8 * MU_0 * turns / (5 * np.sqrt(5) * radius)
        found = allocator.allocate(1e-3 * np.eye(3)[axis]).currents
        expected = [1e-3 / per_ampere * (name == names[0]) - 1e-3 / per_ampere * (name == names[1])
                    for name in coils.names]
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
        # The second derivative vanishes too: B(z) is flat to the fourth order.
        near = coils.field(found, [np.eye(3)[axis] * radius / 20])[0, axis]
        assert abs(near / 1e-3 - 1) < 2 * (1 / 20)**4
    assert coils.names == ('coil_plus_y', 'coil_plus_x', 'coil_minus_y', 'coil_minus_x',
                           'coil_plus_z', 'coil_minus_z')


@pytest.mark.parametrize('file', [SIX, EIGHT])
def test_a_field_turned_about_any_axis_against_an_independent_biot_savart(file):
    coils, peers = CoilSet(file), []
    for winding in file.windings:
        axis = np.array(winding.axis) / np.linalg.norm(winding.axis)
        turn = np.cross((0, 0, 1), axis)
        size = np.linalg.norm(turn)
        turn = turn / size * np.arccos(axis[2]) if size else np.array([np.arccos(axis[2]), 0, 0])
        peers.append(magpylib.current.Circle(diameter=2e-3 * winding.radius_mm,
                                             current=winding.turns)
                     .rotate_from_rotvec(turn, degrees=False)
                     .move(1e-3 * np.array(winding.position_mm)))
    per_ampere = np.array([peer.getB((0, 0, 0)) for peer in peers])
    allocator = Allocator(coils)
    wanted = 4e-3 * np.array([unit(seed, 3) for seed in range(100)])
    np.testing.assert_allclose(allocator.currents(wanted) @ per_ampere, wanted, atol=1e-14)


def test_two_components_lie_in_the_plane_and_two_axes_know_no_third():
    flat, solid = Allocator(CoilSet()), Allocator(CoilSet(SIX))
    np.testing.assert_array_equal(solid.allocate((1e-3, 2e-3)).currents,
                                  solid.allocate((1e-3, 2e-3, 0)).currents)
    around = np.random.default_rng(0).normal(0, 4e-3, (20, 2))
    np.testing.assert_allclose(solid.currents(around), atol=1e-15,
                               desired=[solid.allocate(field).currents for field in around])
    assert flat.matrix.shape == (2, 4)
    assert solid.matrix.shape == (3, 6)
    for allocator, wrong in ((flat, (0, 0, 1e-3)), (solid, (1e-3,)), (flat, (1e-3,))):
        with pytest.raises(ValueError, match='components'):
            allocator.allocate(wrong)


def test_fewer_axes_than_the_coils_can_make_are_had_by_asking():
    coils = CoilSet(SIX.replaced(axes='xy', background_mT=(0.1, 0.2, 0.3)))
    assert coils.axes == 2
    np.testing.assert_allclose(coils.background, (1e-4, 2e-4))
    found = Allocator(coils).allocate((1e-3, 0))
    np.testing.assert_array_equal(found.currents[4:], 0)
    in_space = CoilSet(SIX.replaced(background_mT=(0.1, 0.2)))
    np.testing.assert_allclose(in_space.background, (1e-4, 2e-4, 0))
    assert CoilSet(SIX.replaced(axes=None)).axes == 3
    assert CoilSet(CoilSettings(windings=SIX.windings[:4])).axes == 2


def test_the_direction_that_coils_cannot_make_is_named():
    def refused(settings_: CoilSettings, point=(0, 0, 0)) -> str:
        with pytest.raises(InputError) as error:
            Allocator(CoilSet(settings_), point)
        return str(error.value)

    assert refused(CoilSettings(axes='xyz')).endswith('make no field along z (0.00, 0.00, 1.00)')
    no_y = [winding for winding in SIX.windings if winding.name[-1] != 'y']
    assert refused(CoilSettings(windings=no_y, axes='xyz')).endswith('along y (0.00, 1.00, 0.00)')
    assert refused(CoilSettings(windings=no_y, axes='xy')).endswith('along y (0.00, 1.00, 0.00)')
    tilted = [winding.replaced(axis=(1, 1, 0), position_mm=(k, k, 0))
              for k, winding in zip((30, -30), CoilSettings().windings[:2], strict=True)]
    assert refused(CoilSettings(windings=tilted)).endswith('no field along (0.71, -0.71, 0.00)')
    assert 'at least 3 coils for 3 axes, found 2' in refused(
        CoilSettings(windings=SIX.windings[1:3], axes='xyz'))
    assert 'background_mT: expected a field that the coils can cancel' in refused(
        SIX.replaced(background_mT=(0, 0, 9.5)))
    assert 'a wire or the end of a map is there' in refused(CoilSettings(), (30e-3, 20e-3, 0))


def test_largest_current_is_that_of_the_worst_direction_in_space():
    allocator = Allocator(CoilSet(EIGHT))
    worst = allocator.largest_current(2e-3)
    fields = 2e-3 * np.array([unit(seed, 3) for seed in range(300)])
    assert np.abs(allocator.currents(fields)).max() <= worst * 1.002
    # A row of the inverse is the most that a field of 1 T can ask of that coil.
    inverse = np.linalg.pinv(allocator.matrix)
    assert worst == pytest.approx(2e-3 * np.linalg.norm(inverse, axis=1).max(), rel=2e-3)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_nothing_is_driven_for_a_field_that_is_no_number(bad):
    allocator = Allocator(CoilSet(EIGHT))
    for wanted in ((bad, 0, 0), (1e-3, 0, bad), (bad, 0)):
        with pytest.raises(ValueError, match='finite'):
            allocator.currents(np.array([wanted]))
        with pytest.raises(ValueError, match='must be finite'):
            allocator.allocate(wanted)
        with pytest.raises(ValueError, match='must be finite and not zero'):
            allocator.largest(wanted)


def test_square_rig_saturates_both_coils_of_a_pair_and_leaves_the_other_cold():
    found = Allocator(CoilSet()).allocate((-1, 0))
    np.testing.assert_allclose(found.currents, (0, -2, 0, 2), atol=1e-12)


def test_zero_field_cancels_the_background():
    coils = scattered(1, 4, 'xy')
    found = Allocator(coils).allocate((0, 0))
    assert not found.saturated
    assert np.abs(found.field).max() < 1e-18
    assert np.abs(found.currents).max() > 0
    np.testing.assert_array_equal(Allocator(CoilSet()).allocate((0, 0)).currents, 0)


def test_zero_field_has_no_direction():
    with pytest.raises(ValueError, match='must be finite and not zero'):
        Allocator(CoilSet()).largest((0, 0))


def test_many_fields_at_once_get_the_currents_of_each() -> None:
    allocator = Allocator(scattered(3, 4, 'xy'))
    wanted = np.random.default_rng(1).normal(0, 10e-3, (200, 2))  # some of them out of reach
    each = [allocator.allocate(field) for field in wanted]
    assert 20 < sum(one.saturated for one in each) < 180
    np.testing.assert_allclose(
        allocator.currents(wanted), [one.currents for one in each], rtol=1e-12, atol=1e-15)
