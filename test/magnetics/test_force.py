"""Magnetic force and and the radius inside which the force may be left out."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.common.errors import InputError
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings
from microbot_ros.magnetics.force import (
    MagneticParticle,
    force,
    force_speed,
    negligible_radius,
)


def test_force_is_the_slope_of_the_energy():
    rng = np.random.default_rng(0)
    moment, points = rng.normal(0, 1e-13, (20, 3)), rng.normal(0, 5e-3, (20, 3))
    coils, currents, step = CoilSet(), np.array([1, -0.5, 0.3, 2]), 1e-5
    energy_slope = np.stack([
        ((coils.field(currents, points + d) - coils.field(currents, points - d)) * moment).sum(1)
        for d in step * np.eye(3)], axis=1) / (2 * step)
    found = force(moment, coils.gradient(currents, points))
    np.testing.assert_allclose(found, energy_slope, atol=1e-5 * np.abs(found).max())


def test_force_takes_the_slope_along_the_moment():
    # An open wire's gradient is not symmetric, so (m·∇)B differs from ∇(m·B).
    slope_of_bx_along_y = np.array([[0, 5.0, 0], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(force(np.array([0, 2.0, 0]), slope_of_bx_along_y), (10, 0, 0))
    np.testing.assert_array_equal(force(np.array([2.0, 0, 0]), slope_of_bx_along_y), 0)


def test_moment_follows_the_whole_field_background_included():
    content = CoilSettings().content('not none')
    content['windings'][0]['gain'] = 0.62
    coils = CoilSet(CoilSettings.from_content({**content, 'background_mT': (1.5, -2)}))
    particle, speeds = MagneticParticle(), []
    for angle in np.radians(np.arange(0, 360, 5)):
        # At the centre the whole field is the wanted one, so the moment points along it.
        unit = np.array([np.cos(angle), np.sin(angle), 0])
        currents = Allocator(coils).allocate(1e-3 * unit[:2]).currents
        pull = force(particle.moment * unit, coils.gradient(currents, [[0, 0, 0]])[0])
        speeds.append(np.hypot(*pull[:2]) / particle.drag)
    found = force_speed(coils, np.zeros((1, 3)), 1e-3, particle)
    assert found == pytest.approx(max(speeds), rel=1e-9)


def test_numbers_of_the_papers_particle():
    particle = MagneticParticle()
    assert particle.drag == pytest.approx(1.0795e-7, rel=1e-4)
    assert particle.moment == pytest.approx(4.077e-13, rel=1e-3)


def test_force_is_negligible_on_this_rig_up_to_where_it_is_not():
    coils, particle = CoilSet(), MagneticParticle()
    radius = negligible_radius(coils, 1e-3)
    assert 1.5e-3 < radius < 2e-3  # under 1 % of the slowest particle's own speed
    turned = np.linspace(0, 2 * np.pi, 73)
    circle = np.column_stack([np.cos(turned), np.sin(turned)])
    worst = force_speed(coils, radius * circle, 1e-3, particle).max()
    assert worst / particle.speed == pytest.approx(0.01, rel=1e-4)
    inside = force_speed(coils, np.vstack([0.5 * circle, 0.9 * circle]) * radius, 1e-3, particle)
    assert (inside < 0.01 * particle.speed).all()


def test_the_force_is_that_of_the_field_whatever_core_makes_it():
    linear = CoilSettings()
    curve = ((1.0, 0.9), (2.0, 1.6))
    cored = linear.replaced(windings=tuple(
        one.replaced(saturation=curve) for one in linear.windings))
    at = np.array([[1e-3, 0.3e-3]])
    found, expected = (
        force_speed(CoilSet(coils), at, 3e-3, MagneticParticle()) for coils in (cored, linear))
    assert found == pytest.approx(expected, rel=1e-6)


def test_force_grows_with_moment_and_field():
    coils = CoilSet()
    strong = MagneticParticle(magnetisation=3e3)
    assert negligible_radius(coils, 1e-3, strong, 0.03) == pytest.approx(
        negligible_radius(coils, 1e-3), rel=1e-5)
    # What is a force in proportion to the field is a gradient in proportion to it: B twice.
    point = np.array([[1e-3, 0.4e-3, 0]])
    ratio = force_speed(coils, point, 4e-3, strong) / force_speed(coils, point, 1e-3, strong)
    assert ratio == pytest.approx(4)


def test_uneven_coils_drag_even_at_the_centre():
    content = CoilSettings().content('not none')
    content['windings'][0]['gain'] = 0.62
    coils = CoilSet(CoilSettings.from_content(content))
    assert negligible_radius(coils, 1e-3) == 0
    assert negligible_radius(coils, 1e-3, MagneticParticle(magnetisation=1.0), within=2e-3) == 2e-3


@pytest.mark.parametrize('magnitude', [0, -1e-3, np.nan, np.inf, 9e-3])
def test_magnitudes_that_have_no_answer(magnitude):
    with pytest.raises(InputError, match='magnitude'):
        negligible_radius(CoilSet(), magnitude)
