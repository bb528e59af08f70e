"""Currents from fields: cheapest by an independent solver, largest by linear programming."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from microbot_ros.common.errors import InputError
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings

magpylib = pytest.importorskip('magpylib')


def rig(seed: int, background: float = 0.1) -> CoilSet:
    """A rig as real ones are: gains 38 % apart, signs, limits, poses that are not perfect."""
    rng = np.random.default_rng(seed)
    content = CoilSettings().content('not none')
    for winding in content['windings']:
        winding.update(
            gain=rng.uniform(0.8, 1.1), sign=int(rng.choice([-1, 1])),
            resistance_ohm=rng.uniform(1, 6), max_current_A=rng.uniform(1, 3),
            position_mm=winding['position_mm'] + rng.normal(0, 0.5, 3),
            axis=winding['axis'] + rng.normal(0, 0.05, 3))
    content['background_mT'] = rng.uniform(-background, background, 2)
    return CoilSet(CoilSettings.from_content(content))


def direction(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


def waste(coils: CoilSet, allocator: Allocator, currents: np.ndarray) -> float:
    """How far currents are from the conditions for the least power (Karush, Kuhn, Tucker), 0 to 1.

    Two prices per field must exist, λ, such that 2RI = aᵀλ for coils off their limits and
    |aᵀλ| ≥ 2RI, same sign, for coils at them. A linear programme finds the λ that fails least.
    """
    slope, columns = 2 * coils.resistance * currents, 1e3 * allocator.matrix.T
    upper, lower = currents >= coils.max_current, currents <= -coils.max_current
    rows, bounds = [], []
    for sign, spared in ((1, upper), (-1, lower)):
        kept = ~spared
        rows.append(np.column_stack([sign * columns, -np.ones(4)])[kept])
        bounds.append((sign * slope)[kept])
    solution = linprog([0, 0, 1], np.vstack(rows), np.concatenate(bounds), method='highs',
                       bounds=[(None, None), (None, None), (0, None)])
    return solution.fun / np.abs(slope).max()


def largest_by_linprog(coils: CoilSet, allocator: Allocator, unit: np.ndarray) -> float:
    solution = linprog(
        [0, 0, 0, 0, -1], A_eq=np.column_stack([1e3 * allocator.matrix, -unit]),
        b_eq=-1e3 * coils.background, method='highs',
        bounds=[*[(-limit, limit) for limit in coils.max_current], (0, None)])
    return 1e-3 * solution.x[4]


rigs = st.integers(0, 2**32 - 1).map(rig)
angles = st.floats(0, 2 * np.pi)


@settings(max_examples=60)
@given(rigs, angles, st.floats(0.01, 0.999), st.booleans())
def test_field_in_reach_is_made_exactly_and_as_cheaply_as_can_be(coils, angle, part, off_centre):
    allocator = Allocator(coils, (1e-3, -2e-3, 0) if off_centre else (0, 0, 0))
    wanted = part * allocator.largest(direction(angle)) * direction(angle)
    found = allocator.allocate(wanted)
    assert not found.saturated
    assert (np.abs(found.currents) <= coils.max_current).all()
    np.testing.assert_allclose(found.field, wanted, rtol=1e-8, atol=1e-12)
    assert found.power == pytest.approx(coils.power(found.currents))
    assert waste(coils, allocator, found.currents) < 1e-6


@settings(max_examples=60)
@given(rigs, angles, st.floats(1.0001, 1e6))
def test_field_out_of_reach_keeps_direction_and_the_most_there_is(coils, angle, beyond):
    allocator = Allocator(coils)
    unit = direction(angle)
    largest = largest_by_linprog(coils, allocator, unit)
    found = allocator.allocate(beyond * largest * unit)
    assert found.saturated
    assert (np.abs(found.currents) <= coils.max_current).all()
    assert allocator.largest(7 * unit) == pytest.approx(largest, rel=1e-7)
    np.testing.assert_allclose(found.field, largest * unit, atol=1e-7 * largest)


def test_waste_is_seen():
    coils = rig(0)
    allocator = Allocator(coils)
    spare = np.linalg.svd(allocator.matrix)[2][2]
    found = allocator.allocate((1e-3, 2e-4)).currents
    assert waste(coils, allocator, found) < 1e-6
    assert waste(coils, allocator, found + 1e-3 * spare) > 1e-4


def test_every_direction_against_an_independent_biot_savart():
    coils = CoilSet()
    poses = [((0, 0.03, 0), 'x', -90), ((0.03, 0, 0), 'y', 90),
             ((0, -0.03, 0), 'x', 90), ((-0.03, 0, 0), 'y', -90)]
    peers = [magpylib.current.Circle(diameter=0.04, current=400, position=position)
             .rotate_from_angax(turn, axis, anchor=None) for position, axis, turn in poses]
    per_ampere = np.array([peer.getB((0, 0, 0)) for peer in peers])
    allocator = Allocator(coils)
    for magnitude, tolerance in ((1e-3, 1e-10), (1.0, 1e-8)):
        for angle in np.linspace(0, 2 * np.pi, 181):
            field = allocator.allocate(magnitude * direction(angle)).currents @ per_ampere
            off = np.angle(complex(*field[:2]) * np.exp(-1j * angle))
            assert abs(off) < tolerance


def test_square_rig_saturates_both_coils_of_a_pair_and_leaves_the_other_cold():
    found = Allocator(CoilSet()).allocate((-1, 0))
    np.testing.assert_allclose(found.currents, (0, -2, 0, 2), atol=1e-12)


def test_zero_field_cancels_the_background():
    coils = rig(1)
    found = Allocator(coils).allocate((0, 0))
    assert not found.saturated
    assert np.abs(found.field).max() < 1e-18
    assert np.abs(found.currents).max() > 0
    np.testing.assert_array_equal(Allocator(CoilSet()).allocate((0, 0)).currents, 0)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_nothing_is_driven_for_a_field_that_is_no_number(bad):
    allocator = Allocator(rig(2))
    for wanted in ((bad, 0), (1e-3, bad), (bad, bad)):
        with pytest.raises(ValueError, match='must be finite'):
            allocator.allocate(wanted)
        with pytest.raises(ValueError, match='must be finite and not zero'):
            allocator.largest(wanted)


def test_zero_field_has_no_direction():
    with pytest.raises(ValueError, match='must be finite and not zero'):
        Allocator(CoilSet()).largest((0, 0))


def test_background_beyond_the_coils_and_coils_in_line_are_refused():
    settings_ = CoilSettings(background_mT=(9.0, 0.0))
    with pytest.raises(InputError, match='background_mT: expected a field that the coils can'):
        Allocator(CoilSet(settings_))
    content = CoilSettings().content('not none')
    for k, winding in enumerate(content['windings']):
        winding.update(position_mm=(30 + k, 0, 0), axis=(1, 0, 0))
    with pytest.raises(InputError, match='every field direction'):
        Allocator(CoilSet(CoilSettings.from_content(content)))
    with pytest.raises(InputError, match='every field direction'):
        Allocator(CoilSet(), (30e-3, 20e-3, 0))  # on a wire


# Of the enumeration of faces, which knew four coils and two axes only: (seed, wanted), currents.
ENUMERATED = [
    (0, (1e-3, 2e-3), (0.5692442770779833, -0.34267661046694825, 0.41349798421294676,
                       0.0752015277349352)),
    (0, (3e-3, -8e-3), (-1.0330552710570582, -2.7148085531751387, -2.3412488293872604,
                        -1.7003023321929485)),
    (0, (1, -0.2), (-1.03305527105681, -2.7148085531751387, 0.17982238549893736,
                    1.7778428479582076)),
    (7, (-6e-3, 1e-3), (0.12230095827010834, -1.5097391753082492, 0.3569805733214319,
                        -1.490222363737191)),
    (7, (1, -0.2), (-1.4504143799804297, 1.5097391753082492, 0.8326132590063935,
                    1.4950298440546617)),
]


@pytest.mark.parametrize(('seed', 'wanted', 'currents'), ENUMERATED)
def test_four_coils_get_the_currents_of_before(seed, wanted, currents):
    found = Allocator(rig(seed)).allocate(wanted).currents
    np.testing.assert_allclose(found, currents, atol=2e-11)


def test_many_fields_at_once_get_the_currents_of_each() -> None:
    allocator = Allocator(rig(3))
    wanted = np.random.default_rng(1).normal(0, 10e-3, (200, 2))  # some of them out of reach
    each = [allocator.allocate(field) for field in wanted]
    assert 20 < sum(one.saturated for one in each) < 180
    np.testing.assert_allclose(
        allocator.currents(wanted), [one.currents for one in each], rtol=1e-12, atol=1e-15)
    with pytest.raises(ValueError, match='finite'):
        allocator.currents(np.array([[0.0, np.nan]]))
