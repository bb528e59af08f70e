"""Drag, diffusion and time constants against the paper's numbers, recomputed by hand."""

import math

import numpy as np
import pytest

from microbot_ros.model.physics.particle import (
    Fluid,
    Particle,
    alignment_time,
    force_from_speed,
    rotational_diffusion,
    rotational_drag,
    rotational_time,
    speed_from_force,
    sphere_mass,
    stokes_drag,
    translational_diffusion,
    translational_time,
)

PAPER = Fluid(viscosity=1.245e-3, temperature=298.15)
RADIUS = 4.6e-6
MASS = 4.01e-13


def test_time_constants_of_the_paper():
    assert translational_time(PAPER, RADIUS, MASS) == pytest.approx(3.72e-6, rel=2e-3)
    assert rotational_time(PAPER, RADIUS, MASS) == pytest.approx(1.11e-6, rel=5e-3)


def test_rotational_time_is_inertia_over_drag():
    particle = Particle(RADIUS, MASS, force=0.0)
    expected = particle.moment_of_inertia / rotational_drag(PAPER, RADIUS)
    assert rotational_time(PAPER, RADIUS, MASS) == pytest.approx(expected, rel=1e-14)


def test_terminal_speeds_of_the_paper():
    forces = MASS * np.array([1.00, 1.18, 1.34])
    speeds = speed_from_force(PAPER, RADIUS, forces)
    assert speeds * 1e6 == pytest.approx([3.71, 4.38, 4.98], abs=0.006)
    assert force_from_speed(PAPER, RADIUS, speeds) == pytest.approx(forces, rel=1e-14)


def test_mass_and_radius_of_the_paper_fit_a_density_just_below_water():
    assert sphere_mass(RADIUS, 984.0) == pytest.approx(MASS, rel=1e-3)


def test_diffusion_is_einsteins_relation():
    thermal = 1.380649e-23 * 298.15
    assert translational_diffusion(PAPER, RADIUS) * stokes_drag(PAPER, RADIUS) == (
        pytest.approx(thermal, rel=1e-12))
    # The ratio D/D_r = 4r²/3 holds whatever the fluid.
    ratio = translational_diffusion(PAPER, RADIUS) / rotational_diffusion(PAPER, RADIUS)
    assert ratio == pytest.approx(4 / 3 * RADIUS**2, rel=1e-12)


def test_alignment_is_slower_in_a_weaker_field_and_never_without_one():
    times = alignment_time(PAPER, RADIUS, 1e-14, np.array([1e-3, 0.5e-3, 0.0]))
    assert times[0] == pytest.approx(rotational_drag(PAPER, RADIUS) / 1e-17)
    assert times[1] == pytest.approx(2 * times[0])
    assert times[2] == math.inf
    assert alignment_time(PAPER, RADIUS, 0.0, 1e-3) == math.inf


@pytest.mark.parametrize('bad', [0.0, -1.0, math.nan, math.inf])
def test_impossible_spheres_and_fluids_are_refused(bad):
    with pytest.raises(ValueError, match='viscosity'):
        Fluid(viscosity=bad)
    with pytest.raises(ValueError, match='temperature'):
        Fluid(viscosity=1e-3, temperature=bad)
    with pytest.raises(ValueError, match='radius'):
        Particle(radius=bad, mass=MASS, force=0.0)
    with pytest.raises(ValueError, match='mass'):
        Particle(radius=RADIUS, mass=bad, force=0.0)


@pytest.mark.parametrize('name', ['force', 'phi', 'moment'])
@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(name, bad):
    with pytest.raises(ValueError, match=name):
        Particle(**{'radius': RADIUS, 'mass': MASS, 'force': 0.0, name: bad})
