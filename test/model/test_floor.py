"""Drag near a floor: against exact solutions, published tables and the limits on either side."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import sliding_near_a_wall

from microbot_ros.model.physics.floor import (
    height_of_drag,
    rolling_factor,
    sliding_factor,
    spinning_factor,
)
from microbot_ros.model.physics.particle import (
    Fluid,
    alignment_time,
    force_from_speed,
    rolling_drag,
    rotational_diffusion,
    rotational_drag,
    rotational_time,
    stokes_drag,
    translational_diffusion,
)

FACTORS = (sliding_factor, rolling_factor, spinning_factor)
HEIGHTS = 1 + np.geomspace(1e-5, 1e3, 60)

# Goldman, Cox & Brenner (1967), tables 1 and 2: height over radius, the factors of sliding
# (O'Neill 1964) and of rolling (Dean & O'Neill 1963).
TABLE = np.array([
    (10.0677, 1.0591, 1.0003), (3.7622, 1.1738, 1.0059), (2.3524, 1.3079, 1.0250),
    (1.5431, 1.5675, 1.0998), (1.1276, 2.1514, 1.3877), (1.0453, 2.6475, 1.7079),
    (1.005004, 3.7863, 2.5056), (1.003202, 4.0223, 2.6793)]).T


def test_sliding_is_the_exact_series_to_a_thousandth():
    exact = np.array([sliding_near_a_wall(height, 1.0) for height in HEIGHTS])
    np.testing.assert_allclose(sliding_factor(HEIGHTS, 1.0), exact, rtol=1e-3)


def test_both_are_those_of_the_published_tables():
    np.testing.assert_allclose(sliding_factor(TABLE[0], 1.0), TABLE[1], rtol=1e-3)
    np.testing.assert_allclose(rolling_factor(TABLE[0], 1.0), TABLE[2], rtol=6e-3)


def test_far_away_they_are_faxens_series():
    s = np.geomspace(1e-3, 0.1, 20)
    faxen = 1 - 9 / 16 * s + s**3 / 8 - 45 / 256 * s**4 - s**5 / 16
    # What is left out is of the next order.
    assert (np.abs(sliding_factor(1.0, s) * faxen - 1) < 0.3 * s**4).all()
    assert (np.abs(rolling_factor(1.0, s) - 1 - 5 / 16 * s**3) < 0.1 * s**4).all()
    assert (np.abs(spinning_factor(1.0, s) - 1 - s**3 / 8) < 0.1 * s**6 + 1e-15).all()


@pytest.mark.parametrize('gap', [1e-4, 1e-6, 1e-9])
def test_near_contact_they_are_lubrication(gap):
    height, nearly = 1 + gap, gap * math.log(1 / gap) + 1e-7
    assert sliding_factor(height, 1.0) == pytest.approx(
        8 / 15 * math.log(1 / gap) + 0.9543, abs=nearly)
    assert rolling_factor(height, 1.0) == pytest.approx(
        2 / 5 * math.log(1 / gap) + 0.3709, abs=nearly)
    assert spinning_factor(height, 1.0) == pytest.approx(1.2020569, abs=nearly)  # ζ(3)


def test_spinning_is_jefferys_series():
    n = np.arange(1.0, 3000.0)
    for height in (1.0001, 1.01, 1.3, 2.0, 30.0):
        alpha = math.acosh(height)
        with np.errstate(over='ignore'):
            exact = ((math.sinh(alpha) / np.sinh(n * alpha)) ** 3).sum()
        assert spinning_factor(height, 1.0) == pytest.approx(exact, rel=2e-5)


@pytest.mark.parametrize('factor', FACTORS)
def test_drag_only_grows_towards_the_floor(factor):
    found = factor(np.append(HEIGHTS, 1e9), 1.0)
    assert (np.diff(found) <= 0).all()
    assert (found >= 1).all()
    assert found[-1] == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize('factor', FACTORS)
@pytest.mark.parametrize('height', [1.0, 0.999, 0.0, -2.0, math.nan, math.inf])
def test_a_sphere_in_the_floor_is_refused(factor, height):
    with pytest.raises(ValueError, match='more than the radius'):
        factor(height, 1.0)
    with pytest.raises(ValueError, match='more than the radius'):
        factor(np.array([2.0, height]), 1.0)


@given(st.floats(1.003, 50.0), st.floats(1e-6, 1e-4))
def test_the_height_is_found_back_from_the_drag(ratio, radius):
    height = ratio * radius
    if height - radius > 10e-9:
        factor = float(sliding_factor(height, radius))
        assert height_of_drag(factor, radius) == pytest.approx(height, rel=1e-6)


@pytest.mark.parametrize('factor', [1.0, 0.5, 0.0, -1.0, 4.2, math.inf, math.nan])
def test_no_height_explains_less_drag_than_in_bulk_or_more_than_at_10_nm(factor):
    # 8/15 ln(2.3e-6 / 10e-9) + 0.9543 is 3.86.
    assert height_of_drag(factor, 2.3e-6) is None
    assert height_of_drag(3.8, 2.3e-6) == pytest.approx(2.3e-6, rel=0.01)


def test_all_that_follows_from_drag_follows_it():
    bulk, near = Fluid(1.2e-3), Fluid(1.2e-3, height=2.5e-6)
    radius = np.array([1e-6, 2.3e-6])
    sliding, spinning = sliding_factor(2.5e-6, radius), spinning_factor(2.5e-6, radius)
    rolling = rolling_factor(2.5e-6, radius)
    for of, factor in ((stokes_drag, sliding), (rotational_drag, spinning),
                       (rolling_drag, rolling), (translational_diffusion, 1 / sliding),
                       (rotational_diffusion, 1 / spinning)):
        np.testing.assert_allclose(of(near, radius), of(bulk, radius) * factor, rtol=1e-14)
        assert of(near, 2.3e-6) == pytest.approx(of(near, radius)[1], rel=1e-14)
    assert force_from_speed(near, 2.3e-6, 3e-6) == pytest.approx(
        sliding[1] * force_from_speed(bulk, 2.3e-6, 3e-6))
    assert rotational_time(near, 2.3e-6, 1e-13) == pytest.approx(
        rotational_time(bulk, 2.3e-6, 1e-13) / spinning[1])
    assert alignment_time(near, 2.3e-6, 1e-14, 1e-3) == pytest.approx(
        alignment_time(bulk, 2.3e-6, 1e-14, 1e-3) * spinning[1])


@pytest.mark.parametrize('height', [0.0, -1e-6, math.nan, math.inf])
def test_a_floor_at_no_height_is_refused(height):
    with pytest.raises(ValueError, match='height'):
        Fluid(1e-3, height=height)
