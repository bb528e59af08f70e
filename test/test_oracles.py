"""The oracles themselves, against potentials, numerical derivatives and known limits."""

import math

import numpy as np
import pytest
from oracles import (
    dipole_force,
    dipole_mobility,
    rolled_frequency,
    swimmer_flow,
)

from microbot_ros.common.units import MU_0
from microbot_ros.model.physics.particle import Fluid, stokes_drag


def dipole_field(moment, displacement):
    r = np.linalg.norm(displacement)
    towards = displacement / r
    return MU_0 / (4 * math.pi * r**3) * (3 * (moment @ towards) * towards - moment)


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


def test_dipole_force_is_the_gradient_of_the_interaction_energy():
    first, second = np.array([2e-13, 1e-13]), np.array([-1e-13, 3e-13])
    place = np.array([15e-6, -8e-6])

    def energy(p):
        return -first @ dipole_field(second, p)

    step = 1e-9 * np.eye(2)
    expected = [-(energy(place + s) - energy(place - s)) / 2e-9 for s in step]
    assert dipole_force(first, second, place) == pytest.approx(expected, rel=1e-6)


def test_dipoles_repel_side_by_side_attract_in_line_and_obey_newtons_third_law():
    moment, r = np.array([1e-13, 0.0]), 2e-5
    strength = 3 * MU_0 * 1e-26 / (4 * math.pi * r**4)
    assert dipole_force(moment, moment, np.array([0, r])) == pytest.approx([0, strength])
    assert dipole_force(moment, moment, np.array([r, 0])) == pytest.approx([-2 * strength, 0])
    other, place = np.array([3e-14, -8e-14]), np.array([1e-5, 2e-5])
    assert dipole_force(moment, other, place) == pytest.approx(
        -dipole_force(other, moment, -place))
    assert np.isnan(dipole_force(moment, moment, np.zeros(2))).all()


def test_dipole_mobility_turns_the_force_into_a_speed():
    fluid = Fluid(1.2e-3)
    force = dipole_force(np.array([1e-13, 0]), np.array([1e-13, 0]), np.array([0, 2e-5]))
    speed = force[1] / stokes_drag(fluid, 4e-6)
    assert dipole_mobility(fluid, 4e-6, 1e-13) / 2e-5**4 == pytest.approx(speed)


def test_pusher_blows_along_its_axis_and_draws_in_from_the_sides():
    flow = swimmer_flow(1e-15, 0.0, np.array([[2e-5, 0.0], [0.0, 2e-5], [4e-5, 0.0]]))
    assert flow[0] == pytest.approx([2e-15 / 4e-10, 0])
    assert flow[1] == pytest.approx([0, -1e-15 / 4e-10])
    assert flow[2] == pytest.approx(flow[0] / 4)
    assert np.isnan(swimmer_flow(1e-15, 0.0, np.zeros(2))).all()


def test_swimmer_flow_conserves_volume():
    """Through any sphere about the swimmer as much goes out as comes in."""
    cosines, weights = np.polynomial.legendre.leggauss(20)
    radial = [
        swimmer_flow(1e-15, 0.0, 3e-5 * np.array([c, math.sqrt(1 - c**2)]))
        @ np.array([c, math.sqrt(1 - c**2)]) for c in cosines]
    assert abs(np.dot(weights, radial)) < 1e-12 * np.max(np.abs(radial))
