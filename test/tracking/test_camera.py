"""Pixels ↔ metres: the y flip and the rotation, by hand and by property."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.tracking import ImageToWorkspace


def test_the_centre_is_the_origin_and_y_points_up() -> None:
    camera = ImageToWorkspace(0.5e-6, 640, 480)
    assert camera.position(np.array([319.5, 239.5])) == pytest.approx([0, 0])
    assert camera.position(np.array([329.5, 229.5])) == pytest.approx([5e-6, 5e-6])
    assert camera.vector(np.array([2.0, 2.0])) == pytest.approx([1e-6, -1e-6])
    assert camera.angle(np.array([math.pi / 2])) == pytest.approx([-math.pi / 2])


def test_a_mirrored_picture_is_not_flipped() -> None:
    camera = ImageToWorkspace(1e-6, 3, 3, mirrored=True)
    assert camera.position(np.array([1.0, 2.0])) == pytest.approx([0, 1e-6])
    assert camera.angle(np.array([0.3])) == pytest.approx([0.3])


@settings(max_examples=50)
@given(st.floats(-10, 10), st.booleans(), st.floats(-3, 3), st.floats(1e-8, 1e-3))
def test_there_and_back_and_angles_agree_with_vectors(
    rotation: float, mirrored: bool, angle: float, pixel_size: float
) -> None:
    camera = ImageToWorkspace(pixel_size, 640, 480, rotation, mirrored)
    pixels = np.array([[12.0, 400.0], [500.0, 3.0]])
    np.testing.assert_allclose(camera.pixels(camera.position(pixels)), pixels, atol=1e-9)
    np.testing.assert_allclose(camera.vector_pixels(camera.vector(pixels)), pixels, atol=1e-9)
    direction = camera.vector(np.array([math.cos(angle), math.sin(angle)]))
    turned = camera.angle(np.array(angle))
    assert math.isclose(math.cos(turned - math.atan2(direction[1], direction[0])), 1)
    assert math.isclose(math.cos(camera.image_angle(turned) - angle), 1)
    assert -math.pi < turned <= math.pi


def test_an_unknown_angle_stays_unknown() -> None:
    assert np.isnan(ImageToWorkspace(1e-6, 4, 4, rotation=1.0).angle(np.array([np.nan]))).all()


@pytest.mark.parametrize('pixel_size', [0.0, -1e-6, math.nan, math.inf])
def test_a_pixel_has_a_size(pixel_size: float) -> None:
    with pytest.raises(ValueError, match='pixel_size must be positive'):
        ImageToWorkspace(pixel_size, 640, 480)


@pytest.mark.parametrize('rotation', [math.nan, math.inf, -math.inf])
def test_a_rotation_is_finite(rotation: float) -> None:
    with pytest.raises(ValueError, match='rotation finite'):
        ImageToWorkspace(1e-6, 640, 480, rotation)
