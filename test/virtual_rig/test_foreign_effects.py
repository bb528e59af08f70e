"""Effects that the simulated world knows by their hooks alone, against the fitted equations."""

import math

import numpy as np
import pytest

from microbot_ros.conformance import plain
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.first_order import simulate
from microbot_ros.model.io.model_file import write_model
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.particle import Fluid, rotational_drag
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.foreign_effects import ForeignWorld, foreign_effects, make_world
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, record_session
from microbot_ros.virtual_rig.scenario import read_scenario
from microbot_ros.virtual_rig.simulation import run
from microbot_ros.virtual_rig.world import FieldHistory, World

FIELD = 5e-3
FLUID = Fluid(1.245e-3)
RADIUS = 4.6e-6
SPEEDS = np.array([3.7e-6, 4.4e-6, 5.0e-6])
PHIS = np.array([-1.09, 3.82, 2.64])
PLACES = 1e-6 * np.array([[-30.0, 10.0], [25.0, 20.0], [5.0, -35.0]])
TIMES = np.linspace(0, 4, 17)
NO_WALLS = (math.inf, math.inf)
# Strong enough to see in 4 s, where plain strength is not.
STRONG = {
    'amplifier_deadband': {'deadband': 1e-3},
    'coil_pull': {'rate': 4e-4},
    'background_field': {'bx': 5e-4, 'by': -5e-4},
    'dipole_interaction': {'strength': 3e-25},
    'drive_response': {'cut_in': 1.0, 'slip': 0.6, 'step_out': 8.0},
    'gradient_force': {'rate': 4.0},
    'heading_slip': {'rate': 0.1},
    'hydrodynamic_slowdown': {'length': 6e-6},
    'linear_flow': {'gxx': 0.02, 'gxy': 0.03, 'gyx': 0.01, 'gyy': -0.02},
}


def some(name):
    effect = EFFECTS[name]
    return effect(**STRONG[name]) if name in STRONG else plain(effect)


def command():
    drawn = steps(np.random.default_rng(4), 4.0, (0.4 * FIELD, FIELD), (0.4, 1.5),
                  frequency=(1.0, 6.0))
    drawn.t[0] = -1.0  # commanded before the film begins, so that delays have a past
    return drawn


def swarm(**columns):
    moment = rotational_drag(FLUID, RADIUS) / (0.02e-3 * FIELD)
    first = command().field[0]
    made = bodies(FLUID, np.full(3, RADIUS), np.full(3, moment), PHIS, PLACES, gain=SPEEDS / 4,
                  heading=math.atan2(first[1], first[0]) + PHIS)
    made['diffusion'] = made['rotational_diffusion'] = 0.0
    for name, value in columns.items():
        made[name] = value
    return made


def travel(world):
    path = [world.position]
    for t in TIMES[1:]:
        world.advance(t, FieldHistory.uniform(command()))
        path.append(world.position)
    return np.array(path)


def predicted(*effects):
    particles = ParticleParameters(np.arange(3), SPEEDS / 4, PHIS)
    return simulate(Model(FIELD, 'rolling', effects), particles, command(), TIMES, PLACES)


def hooked(*effects, made=None):
    made = swarm() if made is None else made
    return ForeignWorld(made, np.random.default_rng(0), NO_WALLS, Model(FIELD, effects=effects))


@pytest.mark.parametrize('name', [e for e in EFFECTS if e != 'pixel_anisotropy'])
def test_hooks_move_particles_as_the_equations_say(name):
    expected, without = predicted(some(name)), predicted()
    path = travel(hooked(some(name)))
    assert np.abs(path - expected).max() < 0.02e-6
    assert np.abs(expected - without).max() > 0.1e-6


def test_hooks_see_the_field_that_amplifier_and_coils_leave():
    """What one package hides in the field another package's effect feels."""
    made = swarm()
    inject_effect(made, 'amplifier_deadband', {'deadband_mT': 1.0}, FIELD)
    inject_effect(made, 'coil_gain_mismatch', {'gain_ratio': 0.6}, FIELD)
    weak = EFFECTS['incomplete_alignment'](1e-3)
    path = travel(hooked(weak, made=made))
    both = (EFFECTS['amplifier_deadband'](1e-3), EFFECTS['coil_gain_mismatch'](0.6))
    assert np.abs(path - predicted(weak, *both)).max() < 0.02e-6
    assert np.abs(path - predicted(weak)).max() > 0.1e-6


def test_a_step_leaves_the_bodies_as_they_were():
    world = hooked(*(some(name) for name in ('uniform_drift', 'heading_slip', 'alignment_lag',
                                             'speed_decay')))
    before = world.bodies.copy()
    world.advance(1.0, FieldHistory.uniform(command()))
    for name in before.dtype.names:
        if name not in ('x', 'y', 'heading', 'fuel', 'turns'):
            np.testing.assert_allclose(world.bodies[name], before[name], rtol=1e-12)
    assert world.t == 1.0
    assert np.array_equal(world.advance(0.5, FieldHistory.uniform(command())), world.position)


def test_the_mean_over_a_shutter_is_that_of_the_way():
    moved, plainly = hooked(EFFECTS['uniform_drift'](0.0, 0.0)), World(
        swarm(), np.random.default_rng(0))
    history = FieldHistory.uniform(command())
    np.testing.assert_allclose(
        moved.advance(0.0337, history), plainly.advance(0.0337, history), rtol=1e-9)


def test_the_camera_of_another_package_is_behind_that_of_the_bodies():
    made = swarm()
    inject_effect(made, 'pixel_anisotropy', {'aspect': 1.5}, FIELD)
    rng = np.random.default_rng(0)
    world = hooked(EFFECTS['pixel_anisotropy'](1.2), made=made)
    session, path = record_session(world, command(), Camera(4.0), 1.0, rng)
    _, seen = session.tracks.grid()
    np.testing.assert_allclose(seen, path.position * [1.0, 1.8], rtol=1e-12)


def test_what_the_physics_knows_needs_no_hooks():
    given = {'uniform_drift': {'wx_um_s': 1.0, 'wy_um_s': 0.0}}
    assert foreign_effects(given) == ()
    assert type(make_world(swarm(), np.random.default_rng(0), given, FIELD)) is World
    with pytest.raises(ValueError, match=r'gravity.*unknown effect'):
        make_world(swarm(), np.random.default_rng(0), {'gravity': {'g': 1.0}}, FIELD)


def test_terms_of_single_particles_are_of_their_ids(tmp_path):
    """Factors 2 and ½ of particles that are called 3 and 7, in a simulated session."""
    values = np.array([[1.0], [-0.5]])
    term = LearnedTerm('particle', 'heading', 'speed', (np.array([3.0, 7.0]),), values,
                       values - 0.1, values + 0.1, np.ones(2, bool))
    write_model(tmp_path / 'model.yaml', Model(FIELD, learned=(term,)), ParticleParameters(
        np.array([3, 7]), np.full(2, 4e-6), np.zeros(2)))
    file = tmp_path / 'scenario.yaml'
    file.write_text("""
physics: langevin
duration_s: 10
radius_um: 2.3
reference_field_mT: 5.0
fluid: {viscosity_mPa_s: 1.0}
camera: {frame_rate_hz: 20}
model: model.yaml
commands: {rows: [{t_s: 0, field_mT: 5, direction_deg: 0}]}
""")
    _, place = run(*read_scenario(file), 'scenario').tracks.grid()
    assert (place[-1] - place[0])[:, 0] / 10 == pytest.approx([8e-6, 2e-6], abs=0.5e-6)
