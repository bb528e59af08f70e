"""The first-order integrator against the paper's equation, closed forms and its own refinement."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import fixed_quad, solve_ivp

from microbot_ros.common.records import Commands
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.effects.heading.heading_slip import HeadingSlip
from microbot_ros.model.effects.velocity.dipole_interaction import DipoleInteraction
from microbot_ros.model.effects.velocity.hydrodynamic_slowdown import HydrodynamicSlowdown
from microbot_ros.model.effects.velocity.linear_flow import LinearFlow
from microbot_ros.model.effects.velocity.speed_decay import SpeedDecay
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.alignment_kernel import integrate_alignment

B = 2e-3
PAPER = ParticleParameters(
    np.arange(1, 4), np.array([3.71e-6, 4.38e-6, 4.98e-6]), np.array([-1.09, 3.82, 2.64]))
ORIGIN = np.zeros((3, 2))


def steer(*legs: tuple[float, float], strength: float = B) -> Commands:
    """Legs of (start [s], direction [rad])."""
    t, angle = np.array(legs, dtype=float).T
    return Commands(t, strength * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def test_one_leg_is_the_papers_equation():
    end = simulate(Model(B), PAPER, steer((0.0, 0.7)), np.array([0.0, 5.0]), ORIGIN)[-1]
    expected = 5.0 * PAPER.speed * np.exp(1j * (PAPER.phi + 0.7))
    np.testing.assert_allclose(end @ [1, 1j], expected, rtol=1e-14)


@settings(max_examples=30)
@given(
    switches=st.lists(st.floats(0.001, 3.99), max_size=6, unique=True),
    frames=st.lists(st.floats(0.01, 3.99), max_size=30, unique=True),
    tau=st.sampled_from([0.0, 0.05, 0.7]),
)
def test_frames_do_not_change_where_particles_get_to(switches, frames, tau):
    legs = [(0.0, 0.1), *((s, 5.0 * s) for s in sorted(switches))]
    model = Model(B, effects=(AlignmentLag(tau), UniformDrift(1e-6, 2e-6)))
    few, many = np.array([0.0, 4.0]), np.unique([0.0, *frames, 4.0])
    direct = simulate(model, PAPER, steer(*legs), few, ORIGIN)[-1]
    by_steps = simulate(model, PAPER, steer(*legs), many, ORIGIN)[-1]
    np.testing.assert_allclose(by_steps, direct, rtol=1e-9, atol=1e-17)


def test_a_quarter_turn_with_lag_is_the_closed_form():
    """tan(δ/2) decays with κ, so after a turn by 90° the lost way along the field is ln 2/κ."""
    tau = 0.25
    model = Model(B, effects=(AlignmentLag(tau),))
    commands = steer((0.0, 0.0), (1.0, np.pi / 2))
    one = ParticleParameters(np.array([0]), np.array([1.0]), np.array([0.0]))
    x, y = simulate(model, one, commands, np.array([1.0, 60.0]), np.zeros((1, 2)))[-1, 0]
    assert x == pytest.approx(tau * np.pi / 2, rel=1e-12)
    assert y == pytest.approx(59.0 - tau * np.log(2), rel=1e-12)


def test_an_exact_reversal_is_released_and_not_stuck():
    model = Model(B, effects=(AlignmentLag(0.1),))
    commands = steer((0.0, 0.0), (1.0, np.pi))
    one = ParticleParameters(np.array([0]), np.array([1.0]), np.array([0.0]))
    x = simulate(model, one, commands, np.array([0.0, 1.0, 11.0]), np.zeros((1, 2)))[:, 0, 0]
    assert x[1] == pytest.approx(1.0)
    # Released 0.01 rad from opposition it takes ln(2/0.01) τ to turn half-way.
    assert x[2] == pytest.approx(1.0 - 10.0 + 2 * 0.1 * np.log(2 / 0.01), abs=1e-3)


def test_without_a_field_particles_keep_their_heading():
    commands = Commands(np.array([0.0, 1.0, 3.0]), np.array([[0.0, B], [0, 0], [B, 0]]))
    one = ParticleParameters(np.array([0]), np.array([1.0]), np.array([0.0]))
    for effects in ((), (AlignmentLag(1e-9),)):
        model = Model(B, effects=effects)
        end = simulate(model, one, commands, np.array([0.0, 3.0, 4.0]), np.zeros((1, 2)))
        np.testing.assert_allclose(end[:, 0], [[0, 0], [0, 3], [1, 3]], atol=1e-7)


def test_before_the_first_command_nothing_moves_but_the_liquid():
    times = np.array([0.0, 2.0, 3.0])
    one = ParticleParameters(np.array([0]), np.array([1.0]), np.array([0.0]))
    model = Model(B, effects=(UniformDrift(0.0, 0.5),))
    end = simulate(model, one, steer((2.0, 0.0)), times, np.zeros((1, 2)))
    np.testing.assert_allclose(end[:, 0], [[0, 0], [0, 1.0], [1, 1.5]], atol=1e-15)
    none = Commands(np.zeros(0), np.zeros((0, 2)))
    np.testing.assert_array_equal(
        simulate(Model(B), one, none, times, np.zeros((1, 2))), np.zeros((3, 1, 2)))


def test_a_known_heading_is_followed_from_the_start():
    still = Commands(np.zeros(0), np.zeros((0, 2)))
    heading = np.array([0.1, 1.2, -2.0])
    end = simulate(Model(B), PAPER, still, np.array([0.0, 2.0]), ORIGIN, heading)[-1]
    np.testing.assert_allclose(end @ [1, 1j], 2 * PAPER.speed * np.exp(1j * heading), rtol=1e-12)


def test_each_particle_turns_from_its_own_heading():
    model = Model(B, effects=(AlignmentLag(0.3), UniformDrift(1e-6, 2e-6)))
    commands, heading = steer((-5.0, 0.3), (1.0, 2.0)), np.array([0.4, 1.5, -1.9])
    times = np.linspace(0.0, 3.0, 4)
    simulated = simulate(model, PAPER, commands, times, ORIGIN, heading)

    def right_side(_, state, angle):
        theta = state[6:]
        go = PAPER.speed * 1e6 * np.array([np.cos(theta), np.sin(theta)]) + [[1.0], [2.0]]
        return np.concatenate([*go, np.sin(angle + PAPER.phi - theta) / 0.3])

    state = np.concatenate([np.zeros(6), heading])
    for begin, end, angle in ((0.0, 1.0, 0.3), (1.0, 3.0, 2.0)):
        state = solve_ivp(right_side, (begin, end), state, 'DOP853', args=(angle,),
                          rtol=1e-10, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(simulated[-1].T.ravel() * 1e6, state[:6], atol=1e-7)


def test_a_linear_flow_is_the_matrix_exponential():
    model = Model(B, effects=(LinearFlow(0.0, -0.4, 0.4, 0.0),))
    start = np.array([[1e-5, 0.0], [0.0, 2e-5], [1e-5, 1e-5]])
    still = Commands(np.zeros(0), np.zeros((0, 2)))
    times = np.linspace(0.0, 10.0, 5)
    turned = start @ [1, 1j] * np.exp(0.4j * times[:, None])
    simulated = simulate(model, PAPER, still, times, start) @ [1, 1j]
    np.testing.assert_allclose(simulated, turned, rtol=1e-6)


def test_side_by_side_dipoles_repel_as_the_fifth_root():
    """Two alone obey dr/dt = 2S/r⁴, so r⁵ = r₀⁵ + 10 S t."""
    strength, r0 = 1e-26, 8e-6
    model = Model(B, effects=(DipoleInteraction(strength),))
    pair = ParticleParameters(np.arange(2), np.zeros(2), np.zeros(2))
    end = simulate(model, pair, steer((0.0, np.pi / 2)), np.array([0.0, 20.0]),
                   np.array([[0.0, 0.0], [r0, 0.0]]))[-1]
    assert end[1, 0] - end[0, 0] == pytest.approx((r0**5 + 10 * strength * 20.0) ** 0.2, rel=1e-6)
    np.testing.assert_allclose(end.sum(axis=0), [r0, 0.0], atol=1e-18)


def test_fuel_runs_out_as_the_integral_of_the_exponential():
    one = ParticleParameters(np.array([0]), np.array([3e-6]), np.array([0.0]))
    model = Model(B, effects=(SpeedDecay(2.0),))
    x = simulate(model, one, steer((0.0, 0.0)), np.array([1.0, 10.0]), np.zeros((1, 2)))[-1, 0, 0]
    assert x == pytest.approx(3e-6 * 2.0 * (np.exp(-0.5) - np.exp(-5.0)), rel=1e-12)


def test_neighbours_stop_a_particle_but_do_not_push_it_back():
    model = Model(B, effects=(HydrodynamicSlowdown(9e-6),))
    pair = ParticleParameters(np.arange(2), np.full(2, 3e-6), np.zeros(2))
    start = np.array([[0.0, 0.0], [6e-6, 0.0]])
    end = simulate(model, pair, steer((0.0, 0.0)), np.array([0.0, 2.0]), start)[-1]
    np.testing.assert_array_equal(end, start)


@pytest.mark.parametrize('rate', [0.0, 1e-9, 9.9e-7, 1.1e-6, 1e-3, 2.0, 300.0])
@pytest.mark.parametrize('delta', [0.0, 1e-8, -0.3, 1.6, -3.1])
def test_one_span_of_turning_against_quadrature(rate, delta):
    """tan(δ/2) = tan(δ₀/2) e^{−κs}, integrated by Gauss's rule instead of in closed form."""
    def way(delta):
        tangent = np.tan(delta / 2)
        parts = [fixed_quad(lambda s: np.exp(2j * np.arctan(tangent * np.exp(-rate * s))), a, b,
                            n=40)[0] for a, b in pairwise([0.0, 0.01, 0.03, 0.1, 0.3, 1.0])]
        return sum(parts)

    heading, path, sensitivity, retention = integrate_alignment(
        np.array([np.exp(1j * delta)]), np.ones((1, 1), complex), np.full((1, 1), rate),
        np.array([1.0]))
    h = 1e-5
    after = 2 * np.arctan(np.tan(delta / 2) * np.exp(-rate))
    assert heading[1, 0] == pytest.approx(np.exp(1j * after), abs=1e-14)
    assert path[0, 0] == pytest.approx(way(delta), abs=1e-12)
    slope = (way(delta + h) - way(delta - h)) / (2 * h)
    assert sensitivity[0, 0] == pytest.approx(slope, abs=2e-8)
    slope = np.exp(-rate) / (np.cos(delta / 2) ** 2 + np.sin(delta / 2) ** 2 * np.exp(-2 * rate))
    assert retention[0, 0] == pytest.approx(slope, rel=1e-12)


def test_slip_under_lag_is_of_second_order_in_the_frames():
    model = Model(B, effects=(AlignmentLag(0.3), HeadingSlip(0.5)))
    heading = PAPER.phi + 0.2
    ends = [
        simulate(model, PAPER, steer((0.0, 0.2)), np.linspace(0, 2, n + 1), ORIGIN, heading)[-1]
        for n in (40, 80, 160)
    ]
    ratio = np.abs(ends[0] - ends[1]).max() / np.abs(ends[1] - ends[2]).max()
    assert ratio == pytest.approx(4.0, rel=0.05)


def test_of_two_commands_at_one_time_the_later_holds():
    one = ParticleParameters(np.array([0]), np.array([1.0]), np.array([0.0]))
    twice = steer((0.0, 0.0), (1.0, 2.0), (1.0, np.pi / 2))
    for effects in ((), (LinearFlow(0.0, 0.0, 0.0, 0.0),)):
        end = simulate(Model(B, effects=effects), one, twice, np.array([0.0, 3.0]),
                       np.zeros((1, 2)))[-1, 0]
        np.testing.assert_allclose(end, [1.0, 2.0], rtol=1e-12)


@pytest.mark.parametrize('times', [[0.0], [0.0, 0.0], [1.0, 0.0], [0.0, np.nan], []])
def test_times_must_ascend(times):
    with pytest.raises(ValueError, match='ascending'):
        simulate(Model(B), PAPER, steer((0.0, 0.0)), np.array(times), ORIGIN)
