"""Moments of speed and phase against numerical integration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from microbot_ros.estimation.likelihood.phasor import polar


@pytest.mark.parametrize('size', [0.0, 0.3, 1.0, 3.0, 10.0])
def test_moments_are_those_of_the_rice_likelihood(size):
    speed = np.linspace(0, size + 9, 4001)
    # e^{-v²/2} I₀(v m) as a mean over the angle, which is what I₀ is.
    angle = np.linspace(-np.pi, np.pi, 241)[:-1]
    density = np.array([
        np.exp(-(speed**2 - 2 * speed * size * np.cos(a) + size**2) / 2) for a in angle
    ])
    over_speed = density.mean(axis=0)
    mass = trapezoid(over_speed, speed)
    mean = trapezoid(speed * over_speed, speed) / mass
    std = np.sqrt(trapezoid(speed**2 * over_speed, speed) / mass - mean**2)
    found = polar(np.array([size * 1e-6]), np.array([1e-6]))
    assert found.speed[0] == pytest.approx(mean * 1e-6, rel=1e-4)
    assert found.speed_std[0] == pytest.approx(std * 1e-6, rel=1e-4)
    # The angle of c itself: density over the plane, the area element is v.
    over_angle = (density * speed).sum(axis=1)
    resultant = (over_angle * np.cos(angle)).sum() / over_angle.sum()
    uniform = np.pi / np.sqrt(3)
    expected = min(np.sqrt(-2 * np.log(resultant)), uniform) if resultant > 1e-9 else uniform
    assert found.phi_std[0] == pytest.approx(expected, rel=1e-3)


@given(st.floats(0, 1e-3), st.floats(1e-12, 1e-3), st.floats(-np.pi, np.pi))
def test_speed_and_spread_are_finite_and_positive(size, std, phase):
    found = polar(np.array([size * np.exp(1j * phase)]), np.array([std]))
    assert 0 <= found.speed[0] < np.inf
    assert 0 < found.speed_std[0] <= 1.1 * std
    assert 0 < found.phi_std[0] <= np.pi / np.sqrt(3)


def test_well_known_gains_have_gaussian_spreads():
    found = polar(np.array([4e-6j]), np.array([1e-9]))
    assert found.speed[0] == pytest.approx(4e-6)
    assert found.speed_std[0] == pytest.approx(1e-9, rel=1e-3)
    assert found.phi[0] == pytest.approx(np.pi / 2)
    assert found.phi_std[0] == pytest.approx(1e-9 / 4e-6, rel=1e-3)


@pytest.mark.parametrize('sigmas', [50.0, 100.0, 1e4, 1e6, 1e9, 1e15])
def test_a_speed_that_is_known_far_better_than_it_is_large_is_itself(sigmas):
    found = polar(np.array([4e-6 + 0j]), np.array([4e-6 / sigmas]))
    assert found.speed == pytest.approx(4e-6, rel=1e-3)
    assert found.phi_std == pytest.approx(1 / sigmas, rel=1e-3)
