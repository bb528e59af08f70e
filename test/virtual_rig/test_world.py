"""The simulated world against the equations that the rest of the project fits, and against chance.

Two codes that share no line: here torques and flows in millisecond steps, there closed forms.
"""

import math

import numpy as np
import pytest
from oracles import dipole_force, dipole_mobility, rolled_frequency, swimmer_flow
from scipy import stats

from microbot_ros.common.records import Commands
from microbot_ros.common.units import to_si
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.particle import Fluid, rotational_drag, stokes_drag
from microbot_ros.model.physics.vectors import unit
from microbot_ros.virtual_rig import dynamics
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.injected_effects import LISTED, UNLISTED, inject_effect
from microbot_ros.virtual_rig.world import FieldHistory, World

FLUID = Fluid(1.245e-3)
FIELD = 5e-3
SPEEDS = np.array([3.7e-6, 4.4e-6, 5.0e-6])
PHIS = np.array([-1.09, 3.82, 2.64])
PLACES = 1e-6 * np.array([[-30.0, 10.0], [25.0, 20.0], [5.0, -35.0]])
RADIUS = 4.6e-6


def swarm(aligns_in=0.02e-3, **columns):
    """Three particles without noise that align almost at once."""
    moment = rotational_drag(FLUID, RADIUS) / (aligns_in * FIELD)
    made = bodies(FLUID, np.full(3, RADIUS), np.full(3, moment), PHIS, PLACES, speed=SPEEDS)
    made['diffusion'] = made['rotational_diffusion'] = 0.0
    for name, value in columns.items():
        made[name] = value
    return made


def travel(made, commands, times, rng=0):
    world = World(made, np.random.default_rng(rng))
    path = [world.position]
    for t in times[1:]:
        world.advance(t, FieldHistory.uniform(commands))
        path.append(world.position)
    return np.array(path)


def command(frequency=None, levels=FIELD):
    drawn = steps(np.random.default_rng(4), 12.0, levels, (0.4, 1.5), frequency=frequency)
    drawn.t[0] = -1.0  # commanded before the film begins, so that delays have a past
    return drawn


# Plain strengths: what the effect does over 12 s is many times the tolerance.
STRENGTHS = {
    'uniform_drift': {'wx_um_s': 0.6, 'wy_um_s': -0.4},
    'linear_flow': {'gxx_per_s': 0.01, 'gxy_per_s': -0.02, 'gyx_per_s': 0.015, 'gyy_per_s': 0.02},
    'alignment_lag': {'tau_s': 0.3},
    'background_field': {'bx_mT': 0.7, 'by_mT': -0.5},
    'coil_gain_mismatch': {'gain_ratio': 0.8},
    'coil_misalignment': {'skew_rad': 0.15},
    'speed_decay': {'tau_s': 20.0},
    'command_delay': {'delay_s': 0.25},
    'heading_slip': {'rate_rad_s': 0.03},
    'dipole_interaction': {'strength_um5_s': 3e5},
    'hydrodynamic_slowdown': {'length_um': 6.0},
    'hot_spot': {'x_um': 5.0, 'y_um': 4.0, 'speed_um_s': 2.0, 'width_um': 20.0},
    'periodic_drift': {
        'amplitude_um_s': 2.0, 'frequency_hz': 0.2, 'direction_rad': 0.7, 'phase_rad': 0.4},
    'amplifier_deadband': {'deadband_mT': 1.0},
    'pixel_anisotropy': {'aspect': 1.1},
    'gradient_force': {'rate_per_s_mT': 0.004},
    'coil_pull': {'rate_um_s_mT': 0.05},
    'incomplete_alignment': {'field_scale_mT': 0.8},
    'drive_response': {
        'cut_in_hz': 1.0, 'slip': 0.6, 'step_out_hz': 8.0, 'cut_in_steepness': 3.0,
        'step_out_steepness': 4.0},
}
# How near the two codes must come: a millisecond step now and then straddles a switch. The axis
# that jitters in a weak field leaves σ = 0.14 µm to chance.
MICROMETRE = {'incomplete_alignment': 0.6}


def predicted(effects, commands, times, speeds=SPEEDS, propulsion='catalytic'):
    model = Model(FIELD, propulsion)
    for effect, parameters in effects.items():
        values = {p.name: p for p in EFFECTS[effect].parameters()}
        model = model.with_effect(EFFECTS[effect](
            **{values[name].field: to_si(name, value) for name, value in parameters.items()}))
    particles = ParticleParameters(np.arange(3), speeds, PHIS)
    return simulate(model, particles, commands, times, PLACES)


def test_every_effect_of_the_library_can_be_hidden():
    assert set(LISTED) == set(EFFECTS) == set(STRENGTHS)
    for effect, kind in EFFECTS.items():
        assert set(LISTED[effect]) == {p.name for p in kind.parameters()}


@pytest.mark.parametrize('effect', [e for e in LISTED if e != 'pixel_anisotropy'])
def test_world_and_library_mean_the_same_by(effect):
    """Without noise the two codes agree on where every particle goes, far better than without."""
    rolling = effect == 'drive_response'
    commands = command(
        frequency=(0.5, 2.0, 6.0, 15.0) if rolling else None, levels=(0.4 * FIELD, FIELD))
    times = np.linspace(0, 12, 49)
    made = swarm(gain=0.8e-6, speed=0.0) if rolling else swarm()
    first = commands.field[0]
    made['heading'] = math.atan2(first[1], first[0]) + PHIS
    inject_effect(made, effect, STRENGTHS[effect], FIELD)
    path = travel(made, commands, times)
    how = {'speeds': np.full(3, 0.8e-6), 'propulsion': 'rolling'} if rolling else {}
    expected = predicted({effect: STRENGTHS[effect]}, commands, times, **how)
    without = predicted({}, commands, times, **how)
    tolerance = MICROMETRE.get(effect, 0.02) * 1e-6
    assert np.abs(path - expected).max() < tolerance
    assert np.abs(expected - without).max() > 5 * tolerance


def test_undisturbed_world_is_the_first_order_model():
    times = np.linspace(0, 12, 49)
    path = travel(swarm(heading=1.0), command(), times)
    assert np.abs(path - predicted({}, command(), times)).max() < 0.02e-6


def test_two_effects_at_once_add_up():
    both = {name: STRENGTHS[name] for name in ('alignment_lag', 'uniform_drift')}
    times = np.linspace(0, 12, 25)
    made = swarm(heading=math.atan2(*command().field[0][::-1]) + PHIS)
    for effect, parameters in both.items():
        inject_effect(made, effect, parameters, FIELD)
    expected = predicted(both, command(), times)
    assert np.abs(travel(made, command(), times) - expected).max() < 0.02e-6


def test_a_parameter_can_differ_from_particle_to_particle():
    made = swarm(heading=math.atan2(*command().field[0][::-1]) + PHIS)
    inject_effect(made, 'alignment_lag', {'tau_s': [0.1, 0.3, 0.6]}, FIELD)
    times = np.linspace(0, 12, 25)
    path = travel(made, command(), times)
    for i, tau in enumerate((0.1, 0.3, 0.6)):
        expected = predicted({'alignment_lag': {'tau_s': tau}}, command(), times)
        # Slow turns right about double what a straddled switch left.
        assert np.abs(path[:, i] - expected[:, i]).max() < 0.1e-6


def test_brownian_spread_and_heading_fluctuations():
    count = 400
    moment = rotational_drag(FLUID, 1e-6) / (0.5 * FIELD)
    made = bodies(
        FLUID, np.full(count, 1e-6), np.full(count, moment), np.zeros(count),
        np.column_stack((np.arange(count) * 1e-4, np.zeros(count))), heading=np.zeros(count))
    start = np.column_stack((made['x'], made['y']))
    diffusion, turning = made['diffusion'][0], made['rotational_diffusion'][0]
    world = World(made, np.random.default_rng(1))
    world.advance(0.1, FieldHistory(np.zeros(1), np.zeros((1, 1, 2))))
    low, high = stats.chi2(2 * count).interval(0.999)
    assert low < ((world.position - start) ** 2).sum() / (2 * diffusion * 0.1) < high
    low, high = stats.chi2(count).interval(0.999)
    assert low < (world.heading**2).sum() / (2 * turning * 0.1) < high


def test_mean_over_an_open_shutter_of_a_straight_run():
    made = swarm(heading=PHIS)
    commands = Commands(np.zeros(1), np.array([[FIELD, 0.0]]))
    world = World(made, np.random.default_rng(0))
    before = world.position
    mean = world.advance(0.0337, FieldHistory.uniform(commands))
    assert mean == pytest.approx((before + world.position) / 2, abs=1e-13)


def test_a_field_of_its_own_for_each_particle():
    made = swarm(aligns_in=0.1e-3)
    field = FIELD * unit(np.array([0.0, 1.0, 2.0]))
    made['heading'] = np.array([0.0, 1.0, 2.0]) + PHIS
    world = World(made, np.random.default_rng(0))
    world.advance(2.0, FieldHistory(np.zeros(1), field[None]))
    velocity = (world.position - PLACES) / 2.0
    expected = SPEEDS[:, None] * unit(np.array([0.0, 1.0, 2.0]) + PHIS)
    assert velocity == pytest.approx(expected, abs=1e-12)


def test_walls_stop_particles_and_spheres_do_not_overlap():
    commands = Commands(np.zeros(1), np.array([[FIELD, 0.0]]))
    made = swarm(phi=[0.0, math.pi, 0.0], heading=[0.0, math.pi, 0.0])
    made['x'], made['y'] = [-20e-6, 20e-6, 35e-6], [0.0, 1e-7, 30e-6]
    world = World(made, np.random.default_rng(0), half_extent=(40e-6, 40e-6))
    closest = np.inf
    for t in np.arange(0.1, 12, 0.1):
        world.advance(t, FieldHistory.uniform(commands))
        closest = min(closest, np.hypot(*(world.position[0] - world.position[1])))
    assert closest == pytest.approx(2 * RADIUS, rel=1e-3)
    assert world.position[2, 0] == 40e-6


def test_dipoles_obey_the_force_law():
    moment = 3e-13
    turned = np.add(PHIS, [0.2, 1.3, -0.8])
    made = swarm(dipole=dipole_mobility(FLUID, RADIUS, moment), heading=turned)
    pair = np.array([9e-6, -14e-6])
    distance = np.hypot(*pair)
    velocity = dynamics.dipole_velocity(made[0], made[1], *(pair / distance), distance)
    force = dipole_force(moment * unit(0.2), moment * unit(1.3), pair)
    assert velocity == pytest.approx(force / stokes_drag(FLUID, RADIUS), rel=1e-9)


def test_pusher_moves_its_neighbour_as_its_flow():
    made = swarm(pusher=[0.0, 80e-18, 0.0], heading=[0.0, 0.7, 0.0], dipole=0.0)
    u, v, slowing = dynamics.neighbours(made, 0)
    expected = swimmer_flow(80e-18, 0.7, PLACES[0] - PLACES[1])
    assert (u, v) == pytest.approx(tuple(expected), rel=1e-9)
    assert slowing == 1.0


@pytest.mark.parametrize('frequency', [-20.0, 0.0, 0.5, 1.0, 3.0, 10.0, 25.0])
def test_rollers_follow_the_mechanics(frequency):
    made = swarm(cut_in=1.0, step_out=10.0)
    expected = rolled_frequency(frequency, cut_in=1.0, step_out=10.0)
    assert dynamics.roll_frequency(made[0], frequency) == pytest.approx(float(expected))


UNLISTED_STRENGTHS = {
    'poiseuille_flow': {'speed_um_s': 2.0, 'half_width_um': 60.0},
    'chirality': {'spin_rad_s': 3.0},
    'speed_by_place': {'length_um': 80.0},
    'pulsing_speed': {'depth': 0.5, 'frequency_hz': 0.7},
    'speed_by_heading': {'depth': 0.4},
    'lamp_change': {'time_s': 5.0, 'factor': 0.6},
    'heading_wobble': {'angle_rad': 0.5, 'frequency_hz': 0.3},
    'settling_flow': {'wx_um_s': 1.5, 'wy_um_s': 0.5, 'tau_s': 4.0},
    'trap': {'speed_um_s': 1.0, 'length_um': 40.0},
    'repulsion': {'speed_um_s': 20.0, 'range_um': 15.0},
    'swimmer_flow': {'strength_um3_s': 2000.0},
}


@pytest.mark.parametrize('effect', UNLISTED_STRENGTHS)
def test_every_effect_in_no_library_moves_particles(effect):
    times = np.linspace(0, 12, 13)
    aligns_in = 0.1 if effect == 'chirality' else 0.1e-3
    made = swarm(aligns_in, heading=0.0)
    plain = travel(made.copy(), command(), times)
    inject_effect(made, effect, UNLISTED_STRENGTHS[effect], FIELD)
    assert np.abs(travel(made, command(), times) - plain).max() > 1e-6


def test_unlisted_strengths_cover_all_but_the_camera():
    assert set(UNLISTED_STRENGTHS) == set(UNLISTED) - {'stage_jump'}


@pytest.mark.parametrize(('effect', 'parameters', 'complaint'), [
    ('gravity', {}, "unknown effect 'gravity'; expected one of: uniform_drift"),
    ('uniform_drift', {'wz_um_s': 1.0}, "unknown parameter 'wz_um_s'.*wx_um_s, wy_um_s"),
    ('uniform_drift', {'wx_um_s': math.nan}, 'must be finite'),
    ('command_delay', {'delay_s': [0.1, math.inf, 0.1]}, 'must be finite'),
    ('alignment_lag', {'tau_s': 0.0}, 'must be positive'),
    ('speed_decay', {'tau_s': -3.0}, 'must be positive'),
    ('hot_spot', {'width_um': 0.0}, 'must be positive'),
    ('repulsion', {'range_um': -1.0}, 'must be positive'),
    ('drive_response', {'slip': 0.5, 'cut_in_hz': 1.0}, 'expects also: step_out_hz'),
])
def test_impossible_effects_are_refused(effect, parameters, complaint):
    made = swarm()
    untouched = made.copy()
    with pytest.raises(ValueError, match=complaint):
        inject_effect(made, effect, parameters, FIELD)
    assert np.array_equal(made, untouched)


def test_time_does_not_run_backwards():
    world = World(swarm(), np.random.default_rng(0))
    history = FieldHistory.uniform(command())
    world.advance(1.0, history)
    here = world.position
    assert np.array_equal(world.advance(0.5, history), here)
    assert world.t == 1.0


@pytest.mark.parametrize('kappa', [0.0, 0.3, 4.0, 800.0])
def test_incomplete_alignment_is_langevins_function_on_average(kappa):
    made = swarm(field_scale=1e-3)
    rng = np.random.default_rng(2)
    draws = np.array([dynamics.tilt(made[0], kappa * 1e-3, rng) for _ in range(4000)])
    expected = 1 / math.tanh(kappa) - 1 / kappa if kappa else 0.0
    for mean, sample in zip((expected, 0.0), draws.T, strict=True):
        assert abs(sample.mean() - mean) <= 4 * sample.std() / math.sqrt(len(sample))
    assert (np.hypot(*draws.T) <= 1 + 1e-12).all()


def still(count, **columns):
    """Spheres of 2 µm that nothing moves, side by side, but for what `columns` say."""
    fluid = Fluid(viscosity=1e-3, temperature=1e-6)
    place = 10e-6 * np.arange(count)[:, None] * [1.0, 0.0]
    made = bodies(fluid, np.full(count, 2e-6), 0.0, np.zeros(count), place)
    for name, values in columns.items():
        made[name] = values
    return made


def test_a_sphere_stops_at_a_wall_and_passes_its_end():
    wall = 1e-6 * np.array([[20.0, -50.0, 20.0, 5.0]])
    world = World(still(2, drift_x=1e-5, x=0.0, y=[0.0, 9e-6]), np.random.default_rng(0),
                  walls=wall)
    world.advance(4.0, FieldHistory(np.zeros(1), np.zeros((1, 1, 2))))
    assert world.position[0] == pytest.approx([18e-6, 0.0], abs=1e-8)
    assert world.position[1] == pytest.approx([40e-6, 9e-6], abs=1e-8)
    assert world.touched.tolist() == [True, False]


@pytest.mark.parametrize('ratio', [1.0, 3.0])
def test_one_that_pushes_another_shares_its_force_by_their_drags(ratio):
    """A force F moves both at F/(ζ₁ + ζ₂), where alone it moves the first at F/ζ₁."""
    made = still(3, drift_x=[1e-5, 0.0, 0.0])
    made['drag'][1] *= ratio
    world = World(made, np.random.default_rng(0))
    world.advance(0.6, FieldHistory(np.zeros(1), np.zeros((1, 1, 2))))
    touching = world.position[:2, 0]
    assert touching[1] - touching[0] == pytest.approx(4e-6, rel=1e-6)
    world.advance(0.8, FieldHistory(np.zeros(1), np.zeros((1, 1, 2))))
    gone = world.position[:2, 0] - touching
    assert gone == pytest.approx(0.2 * 1e-5 / (1 + ratio), rel=1e-3)
    assert world.touched.tolist() == [True, True, False]


def test_a_roller_stirs_the_water_ahead_and_behind_and_not_beside():
    """6ωa³h cos ϑ/r³ outward; each rolls with its own frequency."""
    made = still(3, x=[0.0, 20e-6, 0.0], y=[0.0, 0.0, 20e-6], stir=[1e-21, 0.0, 0.0])
    world = World(made, np.random.default_rng(0))
    world.advance(1e-3, FieldHistory(np.zeros(1), np.zeros((1, 1, 2)), np.array([[5.0, 0, 0]])))
    world.advance(0.1, FieldHistory(np.zeros(1), np.zeros((1, 1, 2)), np.array([[5.0, 0, 0]])))
    moved = world.position[1:] - 20e-6 * np.eye(2)
    speed = 1e-21 * 5.0 / 20e-6**3
    assert moved[0] == pytest.approx([0.1 * speed, 0.0], rel=0.02, abs=1e-10)
    assert moved[1] == pytest.approx(0.0, abs=1e-10)
