"""Every effect against its term as the interface writes it: naive, in µm and mT, by an ODE solver.

Nothing of the model's own formulas is used here; the solver is SciPy's at tight tolerance.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from microbot_ros.common.records import Commands
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.first_order import simulate
from microbot_ros.model.io.effect_table import build_effects
from microbot_ros.model.model import Model, ParticleParameters

B_REF = 2.0  # mT
SPEED, PHI = np.array([3.0, 4.5, 5.0]), np.array([-1.1, 2.6, 0.4])  # µm/s (rolling: per Hz), rad
START = np.array([[5.0, -8.0], [-6.0, 3.0], [9.0, 11.0]])  # µm
SWITCHES = np.array([0.0, 0.917, 1.85, 2.6, 3.313])  # s, not on frames
ANGLE = np.array([0.3, 2.9, -2.2, -0.6, 0.9])
STRENGTH = np.array([2.0, 1.0, 3.0, 2.0, 1.5])  # mT
ROTATION = np.array([0.6, 5.0, 9.0, 14.0, 30.0])  # Hz
TIMES = np.arange(121) / 30
FIELD = STRENGTH[:, None] * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)
COMMANDS = Commands(SWITCHES, 1e-3 * FIELD, ROTATION)

TERMS = {
    'uniform_drift': {'wx_um_s': 0.7, 'wy_um_s': -1.1},
    'linear_flow': {'gxx_per_s': 0.02, 'gxy_per_s': -0.05, 'gyx_per_s': 0.03, 'gyy_per_s': 0.01},
    'alignment_lag': {'tau_s': 0.4},
    'background_field': {'bx_mT': 0.3, 'by_mT': -0.5},
    'coil_gain_mismatch': {'gain_ratio': 1.2},
    'coil_misalignment': {'skew_rad': 0.15},
    'speed_decay': {'tau_s': 7.0},
    'command_delay': {'delay_s': 0.21},
    'heading_slip': {'rate_rad_s': 0.08},
    'dipole_interaction': {'strength_um5_s': 4e4},
    'hydrodynamic_slowdown': {'length_um': 2.0},
    'hot_spot': {'x_um': 3.0, 'y_um': -4.0, 'speed_um_s': 2.0, 'width_um': 9.0},
    'periodic_drift': {'amplitude_um_s': 2.0, 'frequency_hz': 1.3, 'direction_rad': 0.7,
                       'phase_rad': 0.4},
    'amplifier_deadband': {'deadband_mT': 0.3},
    'pixel_anisotropy': {'aspect': 1.08},
    'gradient_force': {'rate_per_s_mT': 0.02},
    'coil_pull': {'rate_um_s_mT': 0.3},
    'incomplete_alignment': {'field_scale_mT': 0.8},
    'drive_response': {'cut_in_hz': 0.7, 'slip': 0.35, 'step_out_hz': 10.0},
}


def naive_field(e, t):
    """B [mT] at t, with the effects of stage 1 in the order coils see them."""
    row = np.searchsorted(SWITCHES, t - e('command_delay', 'delay_s'), side='right') - 1
    if row < 0:
        return 0.0, 0.0, 0.0
    bx, by = FIELD[row]
    dead = e('amplifier_deadband', 'deadband_mT')
    bx, by = (math.copysign(max(abs(b) - dead, 0), b) for b in (bx, by))
    by *= e('coil_gain_mismatch', 'gain_ratio', 1.0)
    s = e('coil_misalignment', 'skew_rad')
    bx, by = bx + math.sin(s) * by, math.cos(s) * by
    return bx + e('background_field', 'bx_mT'), by + e('background_field', 'by_mT'), ROTATION[row]


def naive_speed(e, i, t, strength, p, rolling, f):
    v = SPEED[i] * math.exp(-t / e('speed_decay', 'tau_s', math.inf))
    if scale := e('incomplete_alignment', 'field_scale_mT'):
        v *= 1 / math.tanh(strength / scale) - scale / strength
    others = [j for j in range(3) if j != i]
    v *= 1 - sum(e('hydrodynamic_slowdown', 'length_um') / math.dist(p[i], p[j]) for j in others)
    if rolling:
        v *= f
        if e('drive_response', 'slip'):
            v *= f**2 / (f**2 + 0.7**2) * (1 - 0.35 * f**4 / (f**4 + 10.0**4))
    return v


def naive_drift(e, i, t, bx, by, p):
    x, y = p[i]
    strength = math.hypot(bx, by)
    wx, wy = e('uniform_drift', 'wx_um_s'), e('uniform_drift', 'wy_um_s')
    wx += e('linear_flow', 'gxx_per_s') * x + e('linear_flow', 'gxy_per_s') * y
    wy += e('linear_flow', 'gyx_per_s') * x + e('linear_flow', 'gyy_per_s') * y
    swing = e('periodic_drift', 'amplitude_um_s') * math.cos(
        2 * math.pi * e('periodic_drift', 'frequency_hz') * t + e('periodic_drift', 'phase_rad'))
    wx += swing * math.cos(e('periodic_drift', 'direction_rad'))
    wy += swing * math.sin(e('periodic_drift', 'direction_rad'))
    if strength:
        k, c, s = e('gradient_force', 'rate_per_s_mT') * strength, bx / strength, by / strength
        wx += k * ((2 * c**2 - s**2) * x - 2 * c * s * y)
        wy += k * ((2 * s**2 - c**2) * y - 2 * c * s * x)
    wx, wy = wx + e('coil_pull', 'rate_um_s_mT') * bx, wy + e('coil_pull', 'rate_um_s_mT') * by
    if A := e('hot_spot', 'speed_um_s'):
        s = e('hot_spot', 'width_um')
        rx, ry = x - e('hot_spot', 'x_um'), y - e('hot_spot', 'y_um')
        r = math.hypot(rx, ry)
        push = A * (r / s) * math.exp(0.5 - r**2 / (2 * s**2))
        wx, wy = wx + push * rx / r, wy + push * ry / r
    if S := e('dipole_interaction', 'strength_um5_s'):
        for j in range(3):
            if j != i:
                fx, fy = dipole_force(x - p[j][0], y - p[j][1], bx / strength, by / strength)
                wx, wy = wx + S * fx, wy + S * fy
    return wx, wy


def dipole_force(x, y, mx, my):
    """−∇ of the energy (m·m − 3 (m·r̂)²)/(3 r³) of two equal dipoles, by central differences."""
    def energy(x, y):
        r = math.hypot(x, y)
        return (1 - 3 * (mx * x / r + my * y / r) ** 2) / (3 * r**3)

    h = 1e-4
    return ((energy(x - h, y) - energy(x + h, y)) / (2 * h),
            (energy(x, y - h) - energy(x, y + h)) / (2 * h))


def naive_tracks(values, rolling):
    """Measured positions [µm] (T, 3, 2) by integrating the terms between the switches."""
    def e(effect, parameter, otherwise=0.0):
        return values.get(effect, {}).get(parameter, otherwise)

    tau, omega = e('alignment_lag', 'tau_s'), e('heading_slip', 'rate_rad_s')

    def velocity(t, state, bx, by, f):
        p, theta = state[:6].reshape(3, 2), state[6:]
        strength = math.hypot(bx, by)
        rates, turns = [], []
        for i in range(3):
            aim = math.atan2(by, bx) + PHI[i] + omega * t
            heading = theta[i] if tau else aim
            turns.append(strength / B_REF / tau * math.sin(aim - theta[i]) if tau else 0.0)
            wx, wy = naive_drift(e, i, t, bx, by, p)
            v = naive_speed(e, i, t, strength, p, rolling, f) if strength else 0.0
            rates += [v * math.cos(heading) + wx, v * math.sin(heading) + wy]
        return rates + turns

    delay = e('command_delay', 'delay_s')
    bx, by, _ = naive_field(e, delay)
    state = np.concatenate([START.ravel(), math.atan2(by, bx) + PHI])
    tracks = [state[:6]]
    edges = np.unique(np.concatenate([SWITCHES[1:] + delay, [0.0, delay, TIMES[-1]]]))
    for begin, end in pairwise(edges):
        wanted = TIMES[(begin < TIMES) & (end >= TIMES)]
        solved = solve_ivp(velocity, (begin, end), state, 'DOP853', np.unique([*wanted, end]),
                           args=naive_field(e, (begin + end) / 2), rtol=1e-9, atol=1e-9)
        state = solved.y[:, -1]
        tracks += list(solved.y[:6, :len(wanted)].T)
    return np.reshape(tracks, (-1, 3, 2)) * [1.0, e('pixel_anisotropy', 'aspect', 1.0)]


COMBINATIONS = [(name,) for name in TERMS] + [
    ('background_field', 'alignment_lag', 'uniform_drift'),
    ('command_delay', 'alignment_lag', 'speed_decay'),
    ('coil_misalignment', 'coil_gain_mismatch', 'amplifier_deadband', 'background_field'),
    ('heading_slip', 'hot_spot', 'pixel_anisotropy', 'hydrodynamic_slowdown'),
    ('alignment_lag', 'dipole_interaction', 'linear_flow', 'periodic_drift'),
]


def test_every_effect_is_here():
    assert set(TERMS) == set(EFFECTS)


@pytest.mark.parametrize('names', COMBINATIONS, ids='+'.join)
def test_simulation_follows_the_terms_of_the_interface(names):
    values = {name: TERMS[name] for name in names}
    rolling = 'drive_response' in names
    effects = build_effects(values)
    model = Model(B_REF * 1e-3, 'rolling' if rolling else 'catalytic', effects)
    particles = ParticleParameters(np.arange(3), SPEED * 1e-6, PHI)
    simulated = model.observe(simulate(model, particles, COMMANDS, TIMES, START * 1e-6)) * 1e6
    # Exact, but for the middle of each span that stands for what changes slowly within it.
    tolerance = 1e-6 if model.time_invariant and not model.needs_position else 3e-4
    np.testing.assert_allclose(simulated, naive_tracks(values, rolling), atol=tolerance)
