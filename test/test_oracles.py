"""Oracles that nothing else confirms, against integrated equations and known limits."""

import math

import numpy as np
import pytest
from oracles import rolled_frequency, swimmer_flow


def test_slipping_roller_agrees_with_adlers_equation_integrated():
    from scipy.integrate import solve_ivp

    drive, step_out = 14.0, 10.0
    lag = solve_ivp(
        lambda _, y: 2 * math.pi * (drive - step_out * np.sin(y)), (0, 40), [0.0],
        rtol=1e-9, atol=1e-9)
    turned = drive - lag.y[0, -1] / (2 * math.pi * 40)
    assert rolled_frequency(drive, step_out=step_out) == pytest.approx(turned, rel=2e-3)


def test_held_roller_agrees_with_a_tilted_washboard_integrated():
    from scipy.integrate import solve_ivp

    angle = solve_ivp(
        lambda _, y: 2 * math.pi * (3.0 - 2.0 * np.sin(y)), (0, 40), [0.0],
        rtol=1e-9, atol=1e-9)
    turned = angle.y[0, -1] / (2 * math.pi * 40)
    assert rolled_frequency(3.0, cut_in=2.0) == pytest.approx(turned, rel=5e-3)


def test_roller_limits():
    frequency = np.array([-4.0, -0.5, 0.0, 0.5, 1.0, 8.0, 1e4])
    assert rolled_frequency(frequency) == pytest.approx(frequency)
    held = rolled_frequency(frequency, cut_in=1.0)
    assert np.array_equal(held[1:5], np.zeros(4))
    assert held[0] == pytest.approx(-math.sqrt(15))
    # Far above step-out the drive outruns the particle altogether.
    assert 0 < rolled_frequency(1e4, step_out=10.0) < 0.01


def test_swimmer_flow_conserves_volume():
    """Through any sphere about the swimmer as much goes out as comes in."""
    cosines, weights = np.polynomial.legendre.leggauss(20)
    radial = [
        swimmer_flow(1e-15, 0.0, 3e-5 * np.array([c, math.sqrt(1 - c**2)]))
        @ np.array([c, math.sqrt(1 - c**2)]) for c in cosines]
    assert abs(np.dot(weights, radial)) < 1e-12 * np.max(np.abs(radial))
