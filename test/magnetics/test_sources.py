"""Fields and gradients of wires, against limits, a peer library and the other kind of wire."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipkm1

from microbot_ros.common.errors import InputError
from microbot_ros.common.units import MU_0
from microbot_ros.magnetics import Loop, Polyline

magpylib = pytest.importorskip('magpylib')

RADIUS = 0.02
FLAT = Loop(RADIUS, (0, 0, 0), (0, 0, 1))
SQUARE = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 0, 0]]) * RADIUS


def relative(found: np.ndarray, true: np.ndarray) -> float:
    """The largest error of vectors or tensors in the last axes, each relative to its size."""
    found, true = found.reshape(len(found), -1), true.reshape(len(true), -1)
    return (np.linalg.norm(found - true, axis=1) / np.linalg.norm(true, axis=1)).max()


def differences(source: Loop | Polyline, points: np.ndarray, step: float) -> np.ndarray:
    """The gradient by central differences of fourth order."""
    columns = []
    for axis in step * np.eye(3):
        near = source.field_per_ampere(points + axis) - source.field_per_ampere(points - axis)
        far = source.field_per_ampere(points + 2 * axis) - source.field_per_ampere(
            points - 2 * axis)
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-9, 1e-4, 1.0]), st.floats(-3, 3))
def test_loop_agrees_with_magpylib_in_any_pose(seed, off_axis, distance):
    rng = np.random.default_rng(seed)
    pose, centre = Rotation.random(None, rng), rng.normal(0, 0.01, 3)
    local = RADIUS * rng.normal(0, 1, (50, 3)) * (off_axis, off_axis, 10**distance)
    points = centre + pose.apply(local)
    loop = Loop(RADIUS, centre, pose.apply((0, 0, 1)), 7)
    peer = magpylib.current.Circle(
        diameter=2 * RADIUS, current=7, position=centre, orientation=pose)
    assert relative(loop.field_per_ampere(points), peer.getB(points)) < 1e-9


def test_loop_on_its_axis():
    z = RADIUS * np.array([0, 1e-9, -0.3, 1, -50, 1e5])
    field = FLAT.field_per_ampere(np.column_stack([0 * z, 0 * z, z]))
    np.testing.assert_allclose(
        field[:, 2], MU_0 * RADIUS**2 / (2 * (RADIUS**2 + z**2)**1.5), rtol=1e-14)
    assert not field[:, :2].any()


@pytest.mark.parametrize('off_axis', [1e-12, 1e-9, 1e-6])
def test_small_radial_field_beside_the_axis_keeps_its_digits(off_axis):
    # Next to the axis zero divergence leaves Bρ = −ρ/2 ∂Bz/∂z.
    z, rho = 0.7 * RADIUS, off_axis * RADIUS
    slope = -1.5 * MU_0 * RADIUS**2 * z / (RADIUS**2 + z**2)**2.5
    field = FLAT.field_per_ampere([[rho, 0, z]])[0]
    assert field[0] == pytest.approx(-rho / 2 * slope, rel=1e-11)


@pytest.mark.parametrize('far', [1e2, 1e4, 1e8])
def test_far_loop_is_a_dipole(far):
    unit = np.random.default_rng(1).normal(size=(100, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    moment = np.array([0, 0, np.pi * RADIUS**2])
    dipole = (3 * unit * (unit @ moment)[:, None] - moment) * MU_0 / (4 * np.pi)
    dipole /= (far * RADIUS)**3
    error = relative(FLAT.field_per_ampere(far * RADIUS * unit), dipole)
    assert error < 4 / far**2 + 1e-14


@pytest.mark.parametrize('power', [-4, -10, -20, -30])
def test_loop_beside_its_wire(power):
    # Powers of two: the distances to the wire are exact, so nothing is lost before the formula.
    near = 2.0**power
    points = np.array([[1 + near, 0, 0], [1 - near, 0, near], [1, 0, -near]])
    rho, z = points[:, 0], points[:, 2]
    inner, outer = (1 - rho)**2 + z**2, (1 + rho)**2 + z**2
    K, E = ellipkm1(inner / outer), ellipe(1 - inner / outer)
    common = MU_0 / (2 * np.pi * inner * np.sqrt(outer))
    expected = np.column_stack([
        common * z / rho * ((1 + rho**2 + z**2) * E - inner * K), 0 * rho,
        common * (((1 - rho) * (1 + rho) - z**2) * E + inner * K)])
    found = Loop(1, (0, 0, 0), (0, 0, 1)).field_per_ampere(points)
    assert relative(found, expected) < 1e-13


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.3, 0.7, 1.4, 3, 100]),
       st.sampled_from([0, 1e-9, 1e-3, 1]))
def test_gradient_of_a_loop_in_any_pose_is_that_of_its_field(seed, distance, off_axis):
    rng = np.random.default_rng(seed)
    pose, centre = Rotation.random(None, rng), rng.normal(0, 0.01, 3)
    points = rng.normal(size=(40, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points * (off_axis, off_axis, 0.3) + (0, 0, 1)
    points = centre + pose.apply(distance * RADIUS * points)
    loop = Loop(RADIUS, centre, pose.apply((0, 0, 1)), -3)
    step = 3e-3 * RADIUS * max(distance, 0.5)
    assert relative(loop.gradient_per_ampere(points), differences(loop, points, step)) < 1e-7


@pytest.mark.parametrize('power', [-3, -10, -20])
def test_gradient_beside_the_wire(power):
    # Exact steps to points a power of two away from a wire at 1; a straight wire from close by.
    near = 2.0**power
    loop = Loop(1, (0, 0, 0), (0, 0, 1))
    points = np.array([[1 + near, 0, 0], [1 - near, 0, near], [1, 0, -near]])
    gradient = loop.gradient_per_ampere(points)
    assert relative(gradient, differences(loop, points, near / 256)) < 1e-8
    straight = MU_0 / (2 * np.pi * near**2)
    assert gradient[2, 2, 2] == pytest.approx(0, abs=4 * near * straight)
    assert gradient[0, 2, 0] == pytest.approx(straight, rel=2 * near)


def test_polygon_converges_to_the_loop_as_the_square_of_its_sides():
    points = np.random.default_rng(3).normal(0, 0.3 * RADIUS, (50, 3))
    errors = {}
    for sides in (64, 128, 256):
        angles = np.linspace(0, 2 * np.pi, sides + 1)
        corners = RADIUS * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
        corners[-1] = corners[0]
        polygon = Polyline(corners, 5)
        loop = Loop(RADIUS, (0, 0, 0), (0, 0, 1), 5)
        errors[sides] = np.array([
            relative(polygon.field_per_ampere(points), loop.field_per_ampere(points)),
            relative(polygon.gradient_per_ampere(points), loop.gradient_per_ampere(points))])
    np.testing.assert_allclose(errors[64] / errors[128], 4, rtol=0.02)
    np.testing.assert_allclose(errors[128] / errors[256], 4, rtol=0.01)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9))
def test_polyline_agrees_with_magpylib(seed, corners):
    rng = np.random.default_rng(seed)
    vertices, points = rng.normal(0, 0.02, (corners, 3)), rng.normal(0, 0.02, (50, 3))
    peer = magpylib.current.Polyline(vertices=vertices, current=-2)
    found = Polyline(vertices, -2).field_per_ampere(points)
    # Relative to the sum of what the segments make: between them fields may cancel.
    parts = [Polyline(vertices[k:k + 2], 2).field_per_ampere(points) for k in range(corners - 1)]
    size = np.linalg.norm(parts, axis=-1).sum(axis=0)
    assert (np.linalg.norm(found - peer.getB(points), axis=1) < 1e-9 * size).all()


def test_gradient_of_a_closed_polyline_is_that_of_its_field_without_divergence_and_curl():
    points = np.random.default_rng(4).uniform(-0.3 * RADIUS, 0.3 * RADIUS, (50, 3))
    square = Polyline(SQUARE)
    gradient = square.gradient_per_ampere(points)
    size = np.linalg.norm(gradient, axis=(1, 2))
    assert relative(gradient, differences(square, points, 1e-5)) < 1e-7
    assert (np.abs(np.trace(gradient, axis1=1, axis2=2)) < 1e-12 * size).all()
    assert (np.abs(gradient - gradient.swapaxes(1, 2)).max(axis=(1, 2)) < 1e-12 * size).all()


@pytest.mark.parametrize('near', [1e-3, 1e-6, 1e-9])
def test_straight_wire_from_close_by(near):
    # A segment of half-length h at distance d: µ₀I/(2πd) · h/√(h² + d²).
    wire = Polyline([[0, 0, -1], [0, 0, 1]])
    field = wire.field_per_ampere([[near, 0, 0]])[0]
    expected = MU_0 / (2 * np.pi * near) / np.hypot(1, near)
    np.testing.assert_allclose(field, (0, expected, 0), rtol=1e-12)
    gradient = wire.gradient_per_ampere([[near, 0, 0]])[0]
    assert gradient[0, 1] == pytest.approx(-expected / near, rel=1e-12)
    assert gradient[1, 0] == pytest.approx(-expected * (1 / near + near / (1 + near**2)), rel=1e-9)


def test_no_field_on_the_line_beyond_a_segment():
    wire = Polyline([[0, 0, 0], [0, 0, 1]])
    assert not wire.field_per_ampere([[0, 0, 1.5], [0, 0, -2]]).any()


def test_on_the_wire_and_at_points_that_are_nowhere_the_field_is_nan():
    nowhere = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]]
    fine = [[0, 0, 0.001]]
    for source, on in ((FLAT, [[RADIUS, 0, 0], [0, -RADIUS, 0]]),
                       (Polyline(SQUARE), [SQUARE[0], (SQUARE[1] + SQUARE[2]) / 2])):
        points = np.vstack([on, nowhere, fine])
        for values in (source.field_per_ampere(points), source.gradient_per_ampere(points)):
            assert np.isnan(values[:-1]).all()
            assert np.isfinite(values[-1]).all()


def test_turns_and_axis_wind_and_points_in_the_plane_need_no_height():
    points = np.random.default_rng(5).normal(0, 0.01, (20, 3))
    once = FLAT.field_per_ampere(points)
    turned = Loop(RADIUS, (0, 0, 0), (0, 0, -9), -400).field_per_ampere(points)
    np.testing.assert_allclose(turned, 400 * once, rtol=1e-12, atol=1e-20)
    points[:, 2] = 0
    flat = FLAT.field_per_ampere(points[:, :2])
    np.testing.assert_array_equal(flat, FLAT.field_per_ampere(points))
    assert FLAT.field_per_ampere(np.empty((0, 3))).shape == (0, 3)


@pytest.mark.parametrize(('make', 'complaint'), [
    (lambda: Loop(0, (0, 0, 0), (0, 0, 1)), 'radius: expected a positive'),
    (lambda: Loop(-1, (0, 0, 0), (0, 0, 1)), 'radius: expected a positive'),
    (lambda: Loop(np.nan, (0, 0, 0), (0, 0, 1)), 'radius: expected a positive'),
    (lambda: Loop(np.inf, (0, 0, 0), (0, 0, 1)), 'radius: expected a positive'),
    (lambda: Loop(1, (0, np.nan, 0), (0, 0, 1)), 'centre: expected finite'),
    (lambda: Loop(1, (0, 0, 0), (0, 0, 0)), 'axis: expected a direction'),
    (lambda: Loop(1, (0, 0, 0), (0, np.inf, 0)), 'axis: expected finite'),
    (lambda: Loop(1, (0, 0, 0), (0, 0, 1), np.inf), 'turns: expected finite'),
    (lambda: Polyline([[0, 0, 0]]), 'vertices: expected two or more'),
    (lambda: Polyline([[0, 0, 0], [1, 0, 0], [1, 0, 0]]), 'no two neighbours equal'),
    (lambda: Polyline([[0, 0, 0], [np.nan, 0, 0]]), 'vertices: expected finite'),
    (lambda: FLAT.field_per_ampere([0, 0, 0]), 'points: expected an'),
    (lambda: FLAT.field_per_ampere([[0, 0, 0, 0]]), 'points: expected an'),
])
def test_geometry_that_is_none(make, complaint):
    with pytest.raises(InputError, match=complaint):
        make()


def test_the_compiler_is_loaded_with_the_first_field_only():
    code = 'import sys, microbot_ros.magnetics; assert not {"numba", "scipy"} & set(sys.modules)'
    subprocess.run([sys.executable, '-c', code], check=True)
