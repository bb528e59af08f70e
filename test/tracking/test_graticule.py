"""Lines of known spacing and angle, drawn finer than the pixels; and pictures without any."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench._tracker_scenes import expose, light, scene
from microbot_ros.common.errors import InputError
from microbot_ros.tracking.graticule import measure_graticule

_FINE = 3


def graticule(
    period: float, angle: float, *, size: tuple[int, int] = (240, 320), width: float = 0.2,
    every: int = 10, bend: float = 0.0, seed: int = 0,
) -> np.ndarray:
    """Dark lines on uneven light, the longer ones `every` so many; blurred, with noise."""
    height, wide = size
    y, x = np.mgrid[0:height * _FINE, 0:wide * _FINE] / _FINE + (0.5 / _FINE - 0.5)
    across = x * math.cos(angle) + y * math.sin(angle)
    along = y * math.cos(angle) - x * math.sin(angle)
    place = across / period + bend * (across / wide) ** 2 * wide / period + 0.3
    number = np.floor(place + 0.5)
    off = np.abs(place - number) * period
    line = 1 / (1 + np.exp((off - width * period / 2) / 0.7))
    line *= (np.abs(along - along.mean()) < 0.25 * height) | (number % every == 0)
    line = line.reshape(height, _FINE, wide, _FINE).mean(axis=(1, 3))
    return expose(light(*size) - 60 * line, 6.0, np.random.default_rng(seed))


@pytest.mark.parametrize(('period', 'angle', 'width'), [
    (22.2, 0.03, 0.2), (22.2, 1.2, 0.2), (8.7, -0.4, 0.3), (31.4, 0.1, 0.06), (15.0, 0.0, 0.5),
    (17.3, math.pi / 2, 0.3)])
def test_spacing_and_angle_come_out_within_their_spread(
    period: float, angle: float, width: float
) -> None:
    found = measure_graticule(graticule(period, angle, width=width), 'lines')
    assert found.period_px == pytest.approx(period, rel=1e-3)
    assert abs(found.period_px - period) < 5 * found.period_std_px + 2e-4 * period
    turned = math.remainder(found.angle - angle, math.pi)
    assert abs(turned) < min(0.003, 5 * found.angle_std + 2e-4)


def test_bright_lines_and_sixteen_bits_are_as_good() -> None:
    dark = graticule(19.0, 0.2)
    bright = (255 - dark).astype(np.uint16) * 200
    assert measure_graticule(bright, 'lines').period_px == pytest.approx(
        measure_graticule(dark, 'lines').period_px, rel=1e-6)


def test_what_is_no_graticule_is_refused() -> None:
    rng = np.random.default_rng(1)
    for picture in (expose(light(240, 320), 6.0, rng), np.full((240, 320), 90, np.uint8)):
        with pytest.raises(InputError, match='evenly spaced lines'):
            measure_graticule(picture, 'lines')
    with pytest.raises(InputError, match=r'lines\.png: .* lines over the whole'):
        measure_graticule(graticule(12.0, 0.0, bend=0.25, every=1), 'lines.png')
    with pytest.raises(InputError, match='lines'):
        measure_graticule(scene('disc', -60, 15, seed=9, frames=1).frames[0][:200, :60], 'x')
