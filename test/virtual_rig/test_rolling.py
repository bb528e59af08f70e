"""Rollers in a real field: they follow it, step out as theory says, stand where it stands."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from microbot_ros.virtual_rig.rolling import Rolling, turn_moment

MOBILITY = 4e4
STRENGTH = 5e-3
STEP_OUT = MOBILITY * STRENGTH / math.tau


def rolled(frequency, seconds=4.0, axis=(0.0, 1.0), rate=1000.0):
    """How far, in turns, and which way, in the second half."""
    rolling = Rolling(MOBILITY)
    t = np.arange(0, seconds, 1 / rate)
    a, b = axis
    turned = math.tau * frequency * t
    # Starts along the way it rolls, (b, −a), and turns about the axis (a, b, 0).
    field = STRENGTH * np.stack([np.cos(turned) * b, -np.cos(turned) * a, -np.sin(turned)], axis=1)
    rolling.take(t, field, seconds)
    rows = rolling.history(seconds / 2)
    length = np.diff(np.append(rows.t, seconds))
    way = rows.field[:, 0] / np.maximum(np.hypot(*rows.field[:, 0].T), 1e-12)[:, None]
    late = rows.t >= seconds / 2
    return (rows.frequency[late, None] * way[late] * length[late, None]).sum(0) / (seconds / 2)


@pytest.mark.parametrize('frequency', [0.5, 2.0, 10.0, 0.9 * STEP_OUT])
@pytest.mark.parametrize('angle', [0.0, 1.0, 4.0])
def test_it_rolls_a_turn_a_turn_along_the_axis_times_z(frequency, angle):
    axis = (math.cos(angle), math.sin(angle))
    assert rolled(frequency, axis=axis) == pytest.approx(
        frequency * np.array([axis[1], -axis[0]]), rel=0.02, abs=0.02)


@pytest.mark.parametrize('share', [1.2, 2.0])
def test_beyond_the_step_out_it_slips_as_the_adler_equation_says(share):
    frequency = share * STEP_OUT
    expected = frequency - math.sqrt(frequency**2 - STEP_OUT**2)
    found = rolled(frequency, seconds=8.0, rate=8000.0)
    assert np.hypot(*found) == pytest.approx(expected, rel=0.05)


def test_a_field_that_stands_moves_nothing():
    rolling = Rolling(MOBILITY)
    rolling.take(np.array([-1e9, 0.1]), np.array([[0, 0, 0], [0, STRENGTH, 0]]), 5.0)
    assert np.all(rolling.history(1.0).frequency == 0)


def test_the_step_is_the_solution_of_the_equation():
    generator = np.random.default_rng(1)
    for _ in range(10):
        moment, field = generator.normal(size=(2, 3))
        moment /= np.linalg.norm(moment)
        field *= STRENGTH
        exact = solve_ivp(
            lambda _, m, b=field: MOBILITY * np.cross(np.cross(m, b), m), (0, 3e-3), moment,
            rtol=1e-10, atol=1e-12).y[:, -1]
        turned = moment.copy()
        turn_moment(turned, field, MOBILITY, 3e-3)
        assert turned == pytest.approx(exact, abs=1e-6)


def test_pieces_of_time_make_the_whole():
    t = np.arange(0, 1, 1e-3)
    field = STRENGTH * np.stack([np.cos(30 * t), 0 * t, -np.sin(30 * t)], axis=1)
    whole, pieces = Rolling(MOBILITY), Rolling(MOBILITY)
    whole.take(t, field, 1.0)
    for end in np.arange(0.1, 1.05, 0.1):
        pieces.take(t[t < end], field[t < end], end)
    turns = [(rows.frequency[1:] * np.diff(np.append(rows.t, 1.0))[1:]).sum()
             for rows in (whole.history(-1.0), pieces.history(-1.0))]
    assert turns[0] == pytest.approx(turns[1], rel=1e-6)


def test_each_moment_has_a_mobility_of_its_own():
    """Two that are alike do as one does; a third, that is slower to turn, slips and rolls back."""
    t = np.arange(0, 0.5, 1e-3)
    field = STRENGTH * np.stack([np.cos(200 * t), 0 * t, -np.sin(200 * t)], axis=1)
    one, all_three = Rolling(MOBILITY), Rolling([MOBILITY, 3e4, MOBILITY])
    one.take(t, field, 0.5)
    all_three.take(t, field, 0.5)
    alone, rows = one.history(0.0), all_three.history(0.0)
    assert rows.frequency.shape == (len(rows.t), 3)
    assert np.array_equal(rows.frequency[:, 0], rows.frequency[:, 2])
    assert np.array_equal(rows.frequency[:, 0], alone.frequency)
    assert np.array_equal(rows.field[:, 0], alone.field[:, 0])
    # 200 rad/s are within what the first follows and beyond the third: it goes 1 turn in 2.7.
    assert rows.frequency[:, 0].min() >= 0
    assert rows.frequency[:, 1].min() < 0
    way = np.sign(rows.field[-1, 0, 0])
    assert np.sign(rows.field[20:, :2, 0]) == pytest.approx(way)
