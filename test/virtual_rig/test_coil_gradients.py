"""What the simulated coils do to a moment, against the field of the same coils itself."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.model.physics.vectors import unit
from microbot_ros.virtual_rig import dynamics
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.coil_gradients import coil_gradients, pull_of_coil, pull_of_pair
from microbot_ros.virtual_rig.injected_effects import inject_effect

FIELD = 4e-3
PHI = 0.7
RIG = CoilSet()


def body(place, angle, effect, rate, **columns):
    """A particle at `place` (2,) [m] whose moment points at `angle` [rad]."""
    made = bodies(Fluid(1e-3), np.array([2e-6]), 1e-12, np.array([PHI]), np.array([place]),
                  heading=angle + PHI)
    inject_effect(made, effect, {'rate_per_s_mT' if effect == 'gradient_force' else
                                 'rate_um_s_mT': rate}, FIELD)
    for name, value in columns.items():
        made[name] = value
    return made[0]


def strength_slope(coils, currents, place, step=1e-6):
    """∇|B| (2,) [T/m] at one place by central differences."""
    def strength(at):
        return np.linalg.norm(coils.field(currents, at), axis=1)

    sides = step * np.eye(2)
    return (strength(place + sides) - strength(place - sides)) / (2 * step)


@given(x=st.floats(-5e-3, 5e-3), y=st.floats(-5e-3, 5e-3))
def test_between_its_places_the_table_is_near_the_field(x, y):
    """Within 0.01 % of the gradient at the same distance on the axis, everywhere in it."""
    pair = Allocator(RIG).allocate((FIELD, 0.0)).currents
    alone = np.where(np.array(RIG.names) == 'coil_plus_x', 1.0, 0.0)
    size = (2 * pull_of_pair() * math.hypot(x, y), pull_of_coil())
    for currents, table, scale in zip((pair, alone), coil_gradients(), size, strict=True):
        exact = RIG.gradient(currents, [[x, y]])[0] / (RIG.actuation_matrix() @ currents)[0]
        assert dynamics.gradient_at(table, x, y) == pytest.approx(
            (exact[0, 0], exact[0, 1], exact[1, 1]), abs=1e-4 * scale + 1e-9)


@given(x=st.floats(allow_nan=False), y=st.floats(allow_nan=False))
def test_outside_it_holds_what_its_edge_has(x, y):
    edge = 5e-3
    for table in coil_gradients():
        found = dynamics.gradient_at(table, x, y)
        assert np.isfinite(found).all()
        assert found == pytest.approx(dynamics.gradient_at(
            table, min(max(x, -edge), edge), min(max(y, -edge), edge)), rel=1e-9, abs=1e-12)
        for nowhere in ((x, math.nan), (math.nan, y), (math.nan, math.nan)):
            assert np.isfinite(dynamics.gradient_at(table, *nowhere)).all()


@pytest.mark.parametrize('rate', [0.02, -0.003])
@pytest.mark.parametrize('degrees', [0, 20, 45, 90, 160, 250])
def test_a_moment_is_pulled_by_the_slope_of_the_field_of_four_coils(degrees, rate):
    """Only the rate at the centre is said: the rest is ∇|B| of the rig for this command."""
    field = FIELD * unit(math.radians(degrees))
    currents = Allocator(RIG).allocate(field).currents
    per_rate = 2 * FIELD * 1e-5 / np.linalg.norm(strength_slope(
        RIG, Allocator(RIG).allocate((FIELD, 0.0)).currents, np.array([1e-5, 0.0])))
    for place in 1e-4 * np.array([[1.0, 0.3], [-0.6, 2.0], [0.0, -1.4]]):
        moved = dynamics.magnetic_velocity(
            body(place, math.radians(degrees), 'gradient_force', rate), *field, coil_gradients())
        expected = rate * 1e3 * per_rate * strength_slope(RIG, currents, place)
        # The moment lies along the field at the centre, not along that at the place.
        assert moved == pytest.approx(tuple(expected), abs=2e-3 * np.linalg.norm(expected))


@pytest.mark.parametrize('name', RIG.names)
def test_one_coil_pulls_a_moment_towards_itself(name):
    k = RIG.names.index(name)
    made = RIG.actuation_matrix()[:2, k]
    towards = made / np.linalg.norm(made)
    currents = np.eye(4)[k] * FIELD / np.linalg.norm(made)
    at_centre = np.linalg.norm(strength_slope(RIG, currents, np.zeros(2)))
    for place in 1e-4 * np.array([[0.0, 0.0], [1.0, 0.3], [-0.6, 2.0]]):
        x, y = RIG.field(currents, place[None])[0, :2]  # where it is, not at the centre
        one = body(place, math.atan2(y, x), 'coil_pull', 0.2)
        moved = dynamics.magnetic_velocity(one, *(FIELD * towards), coil_gradients())
        expected = 0.2e-3 * FIELD / at_centre * strength_slope(RIG, currents, place)
        assert moved == pytest.approx(tuple(expected), abs=1e-3 * np.linalg.norm(expected))


def test_a_moment_across_the_field_is_pulled_across():
    """It is (m·∇)B and not a slope of |B|: what lags is pulled elsewhere."""
    place = np.array([2e-4, 1e-4])
    one = body(place, math.pi / 2, 'gradient_force', 0.02)
    moved = dynamics.magnetic_velocity(one, FIELD, 0.0, coil_gradients())
    currents = Allocator(RIG).allocate((FIELD, 0.0)).currents
    expected = one['pair_moment'] * RIG.gradient(currents, place[None])[0, :2, 1]
    assert moved == pytest.approx(tuple(expected), rel=1e-3)


def test_coils_pull_as_they_are_wired_and_what_is_no_coil_does_not():
    """A dead band, a gain and a lean change what the coils make; a stray field has no gradient."""
    place, skew = np.array([2e-4, -1e-4]), 0.3
    lean = {'axis': (math.sin(skew), math.cos(skew), 0.0)}
    windings = tuple(
        w.replaced(
            position_mm=tuple(w.position_mm[1] * np.array(lean['axis'])),
            axis=tuple(math.copysign(1, w.position_mm[1]) * np.array(lean['axis'])))
        if w.position_mm[1] else w for w in CoilSettings().windings)
    leaning = CoilSet(CoilSettings(windings=windings))
    made = np.array([FIELD - 1e-3, 0.8 * (FIELD - 1e-3)])
    felt = made @ np.array([[1.0, 0.0], [math.sin(skew), math.cos(skew)]])
    angle = math.atan2(felt[1], felt[0])
    one = body(place, angle, 'gradient_force', 0.02, skew=skew, gain_y=0.8, deadband=1e-3,
               background_x=1e-3)
    moved = dynamics.magnetic_velocity(
        one, *dynamics.coil_fields(one, FIELD, FIELD), coil_gradients())
    # Each pair has its own currents: what it makes along its own axis.
    per_ampere = np.linalg.norm(leaning.actuation_matrix()[:2, 0])
    currents = np.array([made[1], made[0], -made[1], -made[0]]) / (2 * per_ampere)
    gradient = leaning.gradient(currents, place[None])[0, :2, :2]
    expected = one['pair_moment'] * gradient @ unit(angle)
    assert moved == pytest.approx(tuple(expected), rel=2e-3)


def test_without_a_moment_of_its_own_or_a_field_nothing_pulls():
    plain = bodies(Fluid(1e-3), np.array([2e-6]), 1e-12, np.zeros(1), np.full((1, 2), 1e-4))[0]
    assert dynamics.magnetic_velocity(plain, FIELD, FIELD, coil_gradients()) == (0.0, 0.0)
    for effect in ('gradient_force', 'coil_pull'):
        still = body(np.full(2, 1e-4), 0.3, effect, 0.1)
        assert dynamics.magnetic_velocity(still, 0.0, 0.0, coil_gradients()) == (0.0, 0.0)
