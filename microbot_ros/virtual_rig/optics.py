"""Inner loops of the microscope: objects that absorb light, and the sensor."""

from __future__ import annotations

import math

from numpy import ndarray

from microbot_ros.common.compiled import numba


@numba.njit(cache=True)
def _window(centre: float, reach: float, size: int) -> tuple[int, int]:
    return max(0, math.ceil(centre - reach)), min(size, math.floor(centre + reach) + 1)


@numba.njit(cache=True)
def draw_smudge(light: ndarray, x: float, y: float, width: float, depth: float) -> None:
    """Multiply `light` (H, W) by a dark Gaussian spot at (`x`, `y`), std `width` [px].

    In its middle it absorbs the fraction `depth`.

    Parameters
    ----------
    light : ndarray, shape (H, W)
        Light, changed in place.
    x : float
        Column of the centre [px].
    y : float
        Row of the centre [px].
    width : float
        Standard deviation of the spot [px].
    depth : float
        Fraction that is absorbed in the middle.
    """
    top, bottom = _window(y, 4 * width, light.shape[0])
    left, right = _window(x, 4 * width, light.shape[1])
    for i in range(top, bottom):
        for j in range(left, right):
            q = ((i - y) ** 2 + (j - x) ** 2) / (2 * width * width)
            light[i, j] *= 1 - depth * math.exp(-q)


@numba.njit(cache=True)
def _ring(rho: float, radius: float, width: float, blur: float) -> float:
    """Return a ring of unit height, blurred to a lower and wider one of equal cross-section."""
    spread = math.hypot(width, blur)
    return width / spread * math.exp(-((rho - radius) ** 2) / (2 * spread * spread))


@numba.njit(cache=True)
def draw_sphere(light: ndarray, x: float, y: float, heading: float, radius: float, blur: float,
                z: float, cap: float) -> None:
    """Multiply `light` by the transmission of a Janus sphere; lengths in pixels.

    Except for the cap, the transmission is a smooth function of the distance from the centre,
    which is therefore exact. Below the focal plane a dark line borders the edge, above it a bright
    one (Becke line).

    Parameters
    ----------
    light : (H, W) array
        Light of each pixel, changed in place.
    x, y : float
        Centre.
    heading : float [rad]
        In the picture, y down.
    radius, blur : float
        Of the sphere, and standard deviation of the point spread.
    z : float
        Height above the focal plane, within ±1.
    cap : float
        Fraction absorbed by the metal.
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
    """Fill `frame` (H, W) uint8 with `light` and noise of variance light·`shot` + `read_variance`.

    Each row takes its normal deviates from `noise` (M,) at its entry of `starts` (H,).

    Parameters
    ----------
    light : ndarray, shape (H, W)
        Light [grey levels].
    noise : ndarray, shape (M,)
        Normal deviates.
    starts : ndarray, shape (H,)
        First deviate of each row.
    shot : float
        Variance per grey level.
    read_variance : float
        Variance without light.
    frame : ndarray, shape (H, W)
        Uint8, filled in place.
    """
    for i in range(light.shape[0]):
        deviates = noise[starts[i]:starts[i] + light.shape[1]]
        for j in range(light.shape[1]):
            level = light[i, j] + math.sqrt(light[i, j] * shot + read_variance) * deviates[j]
            frame[i, j] = int(min(max(level + 0.5, 0.0), 255.0))
