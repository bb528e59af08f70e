"""The microscope's inner loops: objects that take light away, and the sensor that counts it."""

from __future__ import annotations

import math

from numpy import ndarray

from microbot_ros.common.compiled import numba


@numba.njit(cache=True)
def _window(centre: float, reach: float, size: int) -> tuple[int, int]:
    return max(0, math.ceil(centre - reach)), min(size, math.floor(centre + reach) + 1)


@numba.njit(cache=True)
def draw_smudge(light: ndarray, x: float, y: float, width: float, depth: float) -> None:
    """Multiply `light` (H, W) by a dark Gaussian spot at (x, y), std `width` [px].

    In its middle it takes the part `depth` of the light.
    """
    top, bottom = _window(y, 4 * width, light.shape[0])
    left, right = _window(x, 4 * width, light.shape[1])
    for i in range(top, bottom):
        for j in range(left, right):
            q = ((i - y) ** 2 + (j - x) ** 2) / (2 * width * width)
            light[i, j] *= 1 - depth * math.exp(-q)


@numba.njit(cache=True)
def _ring(rho: float, radius: float, width: float, blur: float) -> float:
    """A ring of unit height blurred to a lower and wider one of the same cross-section."""
    spread = math.hypot(width, blur)
    return width / spread * math.exp(-((rho - radius) ** 2) / (2 * spread * spread))


@numba.njit(cache=True)
def draw_sphere(light: ndarray, x: float, y: float, heading: float, radius: float, blur: float,
                z: float, cap: float) -> None:
    """Multiply `light` (H, W) by the transmission of a Janus sphere at (x, y), all in pixels.

    `radius` of the sphere; `heading` [rad] as it is on the picture, y down; `blur` is the standard
    deviation of the point spread; `z` within ±1 is how far the sphere is above the focal plane:
    below it the edge is bordered by a dark line, above it by a bright one (Becke's line). `cap` is
    the part of the light that the metal takes; but for it the transmission is a smooth function of
    the distance from (x, y) alone: its centre is exact.
    """
    reach = radius + 5 * blur + 2
    top, bottom = _window(y, reach, light.shape[0])
    left, right = _window(x, reach, light.shape[1])
    ahead_x, ahead_y = math.cos(heading), math.sin(heading)
    soft = 1 / (math.sqrt(2) * blur)
    core = 0.28 * radius
    gathered = core * core / (core * core + blur * blur)
    for i in range(top, bottom):
        for j in range(left, right):
            dx, dy = j - x, i - y
            rho = math.hypot(dx, dy)
            inside = 0.5 * math.erfc((rho - radius) * soft)
            behind = 0.5 * math.erfc((dx * ahead_x + dy * ahead_y) * soft)
            bright = 0.5 * gathered * math.exp(-gathered * rho * rho / (2 * core * core))
            body = 1 - 0.28 * inside - 0.62 * _ring(rho, 0.84 * radius, 0.15 * radius, blur)
            border = 0.10 * z * _ring(rho, radius + 1.5 * blur, 0.2 * radius, blur)
            light[i, j] *= max(0.02, (body + bright + border) * (1 - cap * inside * behind))


@numba.njit(cache=True, fastmath=True)
def count_electrons(light: ndarray, noise: ndarray, starts: ndarray, shot: float,
                    read_variance: float, frame: ndarray) -> None:
    """Fill `frame` (H, W) uint8 with `light` and noise of variance light·shot + read_variance.

    Each row takes its normal deviates from `noise` (M,) where `starts` (H,) says.
    """
    for i in range(light.shape[0]):
        deviates = noise[starts[i]:starts[i] + light.shape[1]]
        for j in range(light.shape[1]):
            level = light[i, j] + math.sqrt(light[i, j] * shot + read_variance) * deviates[j]
            frame[i, j] = int(min(max(level + 0.5, 0.0), 255.0))
