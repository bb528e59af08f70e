"""The same fit as `fit`, for round particles, in a fixed number of dot products.

For a particle near the centre of one cell of a sub-pixel lattice, the picture is linear in
contrast, offset and small changes of position and size. The least-squares solution is then a
fixed set of filters per cell, computed once. Each turn moves a particle to its nearest cell, so
after two turns what is left to the linear step is a sixteenth of a pixel.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from microbot_ros.tracking.appearance import Appearance
from microbot_ros.tracking.fit import (
    CONTRAST,
    OFFSET,
    PARAMETERS,
    SIZE,
    TABLE_STEP,
    X,
    Y,
    background_at,
)

_CELLS = 6
"""Cells per pixel and axis."""

_SETTLED = 0.125
_SETTLED_AMONG_OTHERS = 0.04
"""Pixels: after a smaller move another turn would give the same; neighbours need more turns."""

_FAST = {'reassoc', 'contract', 'arcp', 'nsz'}
_UNKNOWNS = (CONTRAST, X, Y, SIZE, OFFSET)
_LARGEST_CHANGE = 0.75


class Lattice:
    """Filters of every sub-pixel cell for one appearance."""

    def __init__(self, appearance: Appearance) -> None:
        half = int(np.ceil(appearance.reach_px + 0.5))
        # Rows of whole vectors are several times faster; what is too much weighs nothing.
        across = -(-(2 * half + 1) // 4) * 4
        v, u = np.mgrid[-half:half + 1, -half:across - half].astype(float)
        self._near = appearance.reach_px + 0.25 * appearance.diameter_px
        shape = (_CELLS, _CELLS)
        self._filters = np.zeros((*shape, 5, *u.shape), np.float32)
        self._picture = np.zeros((*shape, *u.shape), np.float32)
        self._disc = np.zeros((*shape, *u.shape), np.float32)
        self._normal = np.zeros((*shape, 5, 5))
        self._covariance = np.zeros((*shape, 5, 5))
        for j in range(_CELLS):
            for i in range(_CELLS):
                x, y = (np.array([i, j]) + 0.5) / _CELLS - 0.5
                self._fill(j, i, u - x, v - y, appearance)

    def _fill(
        self, j: int, i: int, u: np.ndarray, v: np.ndarray, appearance: Appearance
    ) -> None:
        radii = np.arange(appearance.table.shape[1]) * TABLE_STEP
        profile = appearance.table[0]
        r = np.maximum(np.hypot(u, v), 1e-9)
        slope = np.interp(r, radii, np.gradient(profile, TABLE_STEP), right=0.0)
        picture = np.interp(r, radii, profile, right=0.0)
        disc = r <= appearance.reach_px
        columns = [picture, -slope * u / r, -slope * v / r, -slope * r, np.ones_like(r)]
        design = np.array([(column * disc).ravel() for column in columns])
        normal = design @ design.T
        covariance = np.linalg.inv(normal)
        self._normal[j, i], self._covariance[j, i] = normal, covariance
        self._filters[j, i] = (covariance @ design).reshape(5, *r.shape)
        self._picture[j, i] = picture * (r <= appearance.reach_px + 1)
        self._disc[j, i] = disc

    def fit(
        self, image: np.ndarray, grid: np.ndarray, spacing: int, parameters: np.ndarray,
        active: np.ndarray, model: np.ndarray, turns: int,
    ) -> np.ndarray:
        """Fit particles in place; see `fit.fit` for what goes in and out.

        `model` (H, W) float32 zeros: working space, zero again afterwards. Beyond the edge of
        the picture its last pixels are repeated.
        """
        return _fit(
            image, grid, spacing, parameters, active, model, turns, self._near, self._filters,
            self._picture, self._disc, self._normal, self._covariance)


@numba.njit(cache=True, inline='always')
def _place(row):  # type: ignore[no-untyped-def]
    """Whole pixel and lattice cell of a position."""
    x, y = math.floor(row[X] + 0.5), math.floor(row[Y] + 0.5)
    i = min(int((row[X] - x + 0.5) * _CELLS), _CELLS - 1)
    j = min(int((row[Y] - y + 0.5) * _CELLS), _CELLS - 1)
    return int(x), int(y), i, j


@numba.njit(cache=True, fastmath=_FAST)
def _draw(model, row, scale, pictures):  # type: ignore[no-untyped-def]
    """Add `scale` times the particle to the model."""
    x, y, i, j = _place(row)
    picture = pictures[j, i]
    half = picture.shape[0] // 2
    contrast = np.float32(scale * row[CONTRAST])
    left, right = max(x - half, 0), min(x - half + picture.shape[1], model.shape[1])
    columns = numba.uintp(right - left)
    from_x, to_x = numba.uintp(left - x + half), numba.uintp(left)
    for py in range(max(y - half, 0), min(y + half + 1, model.shape[0])):
        from_y, to_y = numba.uintp(py - y + half), numba.uintp(py)
        for k in range(columns):
            model[to_y, to_x + k] += contrast * picture[from_y, from_x + k]


@numba.njit(cache=True, fastmath=_FAST)
def _gather(image, grid, spacing, model, x, y, window):  # type: ignore[no-untyped-def]
    """Fill a window with what light and neighbours leave."""
    rows, columns = window.shape
    half = rows // 2
    height, width = image.shape
    light = background_at(grid, spacing, float(x), float(y))
    slope_x = (background_at(grid, spacing, float(x + half), float(y))
               - background_at(grid, spacing, float(x - half), float(y))) / (2 * half)
    slope_y = (background_at(grid, spacing, float(x), float(y + half))
               - background_at(grid, spacing, float(x), float(y - half))) / (2 * half)
    step = np.float32(slope_x)
    if half <= x < width - columns + half and half <= y < height - half:
        # Unsigned indices can't wrap around, which lets the compiler use vectors.
        left = numba.uintp(x - half)
        for dy in range(rows):
            start = np.float32(light + slope_y * (dy - half) - slope_x * half)
            py, wy = numba.uintp(y - half + dy), numba.uintp(dy)
            for k in range(numba.uintp(columns)):
                rest = np.float32(image[py, left + k]) - model[py, left + k]
                window[wy, k] = rest - start - step * np.float32(k)
        return
    for dy in range(rows):
        py = min(max(y - half + dy, 0), height - 1)
        for k in range(columns):
            px = min(max(x - half + k, 0), width - 1)
            light_here = light + slope_y * (dy - half) + slope_x * (k - half)
            window[dy, k] = image[py, px] - model[py, px] - light_here


@numba.njit(cache=True, fastmath=_FAST)
def _project(window, filters, disc, solution):  # type: ignore[no-untyped-def]
    """The linear solution; returns the window's sum of squares in the disc."""
    rest, weight = window.ravel(), disc.ravel()
    f0, f1, f2 = filters[0].ravel(), filters[1].ravel(), filters[2].ravel()
    f3, f4 = filters[3].ravel(), filters[4].ravel()
    a = b = c = d = e = squares = np.float32(0.0)
    for m in range(rest.size):
        value = rest[m]
        a += f0[m] * value
        b += f1[m] * value
        c += f2[m] * value
        d += f3[m] * value
        e += f4[m] * value
        squares += weight[m] * value * value
    solution[0], solution[1], solution[2], solution[3], solution[4] = a, b, c, d, e
    return squares


@numba.njit(cache=True, fastmath=_FAST)
def _update(row, solution, i, j, x, y):  # type: ignore[no-untyped-def]
    """Parameters from the linear solution about the centre of a cell."""
    contrast = solution[0]
    row[CONTRAST] = contrast
    row[OFFSET] = solution[4]
    if not abs(contrast) > 1e-6:
        return
    dx, dy = solution[1] / contrast, solution[2] / contrast
    longest = max(abs(dx), abs(dy)) / _LARGEST_CHANGE
    if longest > 1:
        dx, dy = dx / longest, dy / longest
    row[X] = x + (i + 0.5) / _CELLS - 0.5 + dx
    row[Y] = y + (j + 0.5) / _CELLS - 0.5 + dy
    row[SIZE] = 1 + solution[3] / contrast


@numba.njit(cache=True, fastmath=_FAST)
def _conclude(row, errors, squares, solution, normal, covariance, pixels):  # type: ignore[no-untyped-def]
    explained = 0.0
    for m in range(5):
        for n in range(5):
            explained += solution[m] * normal[m, n] * solution[n]
    variance = max(squares - explained, 0.0) / (pixels - 5)
    contrast = max(abs(row[CONTRAST]), 1e-6)
    errors[CONTRAST] = math.sqrt(variance * covariance[0, 0])
    errors[X] = math.sqrt(variance * covariance[1, 1]) / contrast
    errors[Y] = math.sqrt(variance * covariance[2, 2]) / contrast
    errors[SIZE] = math.sqrt(variance * covariance[3, 3]) / contrast
    errors[OFFSET] = math.sqrt(variance * covariance[4, 4])
    errors[PARAMETERS] = variance
    errors[PARAMETERS + 1] = pixels


@numba.njit(cache=True)
def _neighbours(parameters, near):  # type: ignore[no-untyped-def]
    """Whether each particle has another within `near` px in x and y."""
    close = np.zeros(len(parameters), np.bool_)
    order = np.argsort(parameters[:, Y])
    for m in range(len(order)):
        i = order[m]
        for n in range(m + 1, len(order)):
            j = order[n]
            if parameters[j, Y] - parameters[i, Y] >= near:
                break
            if abs(parameters[j, X] - parameters[i, X]) < near:
                close[i] = close[j] = True
    return close


@numba.njit(cache=True)
def _turn(image, grid, spacing, row, error, model, shared, window, solution, filters, pictures, discs, normals, covariances):  # type: ignore[no-untyped-def]  # noqa: E501
    """Refit one particle about its present cell; returns how far it moved, −1 if out of view."""
    if shared:
        _draw(model, row, -1.0, pictures)
    x, y, i, j = _place(row)
    before_x, before_y = row[X], row[Y]
    _gather(image, grid, spacing, model, x, y, window)
    squares = _project(window, filters[j, i], discs[j, i], solution)
    _update(row, solution, i, j, x, y)
    if not (-0.5 <= row[X] < image.shape[1] - 0.5 and -0.5 <= row[Y] < image.shape[0] - 0.5):
        row[X], row[Y], row[CONTRAST] = x, y, 0.0
        error[:] = np.nan
        return -1.0
    if shared:
        _draw(model, row, 1.0, pictures)
    normal = normals[j, i]
    _conclude(row, error, squares, solution, normal, covariances[j, i], normal[4, 4])
    return max(abs(row[X] - before_x), abs(row[Y] - before_y))


@numba.njit(cache=True)
def _fit(image, grid, spacing, parameters, active, model, turns, near, filters, pictures, discs, normals, covariances):  # type: ignore[no-untyped-def]  # noqa: E501
    count = parameters.shape[0]
    errors = np.full((count, PARAMETERS + 2), np.nan)
    window = np.empty(pictures.shape[2:], np.float32)
    solution = np.empty(5)
    waiting = active.copy()
    shared = _neighbours(parameters, near)
    for n in range(count):
        if shared[n]:
            _draw(model, parameters[n], 1.0, pictures)
    for _ in range(turns):
        for n in range(count):
            if waiting[n]:
                moved = _turn(
                    image, grid, spacing, parameters[n], errors[n], model, shared[n], window,
                    solution, filters, pictures, discs, normals, covariances)
                waiting[n] = moved > (_SETTLED_AMONG_OTHERS if shared[n] else _SETTLED)
    model[:] = 0
    return errors
