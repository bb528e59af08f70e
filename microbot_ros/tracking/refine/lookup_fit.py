"""The same fit as `fit`, for round particles, in a fixed number of dot products.

For a particle near the centre of a cell of a sub-pixel lattice, the picture is linear in contrast,
offset and small changes of position and size. The least-squares solution is then a fixed set of
overlaps per cell, computed once. Each turn moves a particle to its nearest cell; when that step is
short enough for linearity, the fit is done. Particles cut by the edge of the picture have other
overlaps at each position, computed there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.refine.fit import (
    CONTRAST,
    FAST,
    OFFSET,
    PARAMETERS,
    SIZE,
    TABLE_STEP,
    X,
    Y,
    background_at,
    invert,
)
from microbot_ros.tracking.refine.neighbours import neighbours

_CELLS = 4
"""Choice: cells per pixel and axis."""

_EXACT = 0.0005
"""Choice: error of the linear step [px], far below any noise."""

_SETTLED_AMONG_OTHERS = 0.04
"""Choice: move [px] after which another turn changes nothing, neighbours included."""

# Choices: most turns of a particle alone, cut by the edge, among others; longest step [px].
_TURNS, _TURNS_CUT, _TURNS_AMONG_OTHERS = 2, 6, 6
_LARGEST_CHANGE = 0.75  # choice: longest step [px]; a longer one may leave the valley

_LEAST_IN_VIEW = 0.4
"""Choice: share of the fitted disc that must lie in the picture."""


class _Tables(NamedTuple):
    """Per cell (row, column): design D (5, h·w), picture (h′, w′), (DᵀD)⁻¹, pixels; window (h, w).

    The rows of D are the changes of the picture with contrast, x, y, size and offset, zero beyond
    the fitted disc; the last row is thus the disc itself. The picture extends further.
    """

    design: np.ndarray
    picture: np.ndarray
    covariance: np.ndarray
    pixels: np.ndarray
    window: tuple[int, int]


class LookupFit:
    """Pictures and their derivatives at every sub-pixel cell, for one `appearance`.

    Parameters
    ----------
    appearance : Appearance
        The learned picture.
    """

    def __init__(self, appearance: Appearance) -> None:
        self._near = appearance.reach_px + 0.25 * appearance.diameter_px
        off = (np.arange(_CELLS) + 0.5) / _CELLS - 0.5
        u, v = _window(appearance.reach_px + off[-1])
        design = np.array([[_draw_design(appearance, u - x, v - y) for x in off] for y in off])
        wide_u, wide_v = _window(appearance.reach_px + 1 + off[-1])
        picture = np.array([[_draw(appearance, wide_u - x, wide_v - y) for x in off] for y in off])
        normal = design @ design.swapaxes(2, 3)
        self._tables = _Tables(
            design.astype(np.float32), picture.astype(np.float32), np.linalg.inv(normal),
            normal[:, :, 4, 4].copy(), u.shape)
        self._settled = _longest_linear_step(appearance, u, v)

    def fit(
        self, image: np.ndarray, grid: np.ndarray, spacing: int, parameters: np.ndarray,
        active: np.ndarray,
    ) -> np.ndarray:
        """Fit particles of an `image` in place.

        `grid`, `spacing`, `parameters`, `active` and the result are as in `fit.fit`.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        grid : ndarray, shape (h, w)
            Background of each cell [grey].
        spacing : int
            Size of a cell [px].
        parameters : ndarray, shape (N, 6)
            Parameters of the particles, as in `fit.fit`.
        active : ndarray, shape (N,)
            Whether each is fitted.

        Returns
        -------
        ndarray
            As `fit.fit`.
        """
        return _fit(
            image, grid, spacing, parameters, active, self._near, self._settled, self._tables)


def _window(reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets u, v (h, w) [px] of the pixels within `reach` along each axis."""
    half = int(reach)
    # Rows of whole vectors are several times faster; padding has zero weight.
    across = -(-(2 * half + 1) // 4) * 4
    v, u = np.mgrid[-half:half + 1, -half:across - half].astype(float)
    return u, v


def _draw(appearance: Appearance, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the picture (h, w) at offsets u, v [px] from the centre, to 1 px beyond the disc."""
    near = np.hypot(u, v) <= appearance.reach_px + 1
    return np.where(near, appearance.draw_round(u, v), 0.0)


def _draw_design(appearance: Appearance, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the design (5, h·w) at offsets u, v [px] from the centre."""
    radii = np.arange(appearance.table.shape[1]) * TABLE_STEP
    r = np.maximum(np.hypot(u, v), 1e-9)
    slope = np.interp(r, radii, np.gradient(appearance.table[0], TABLE_STEP), right=0.0)
    picture = appearance.draw_round(u, v)
    columns = [picture, -slope * u / r, -slope * v / r, -slope * r, np.ones_like(r)]
    return (np.array(columns) * (r <= appearance.reach_px)).reshape(5, -1)


def _longest_linear_step(appearance: Appearance, u: np.ndarray, v: np.ndarray) -> float:
    """Return the longest step along an axis [px] with an error within `_EXACT`."""
    design = _draw_design(appearance, u, v)
    steps = np.arange(0.08, 0.42, 0.02)
    for step in steps:
        moved = _draw(appearance, u - step, v).ravel() * design[-1]
        solution = np.linalg.lstsq(design.T, moved, rcond=None)[0]
        if not abs(solution[1] / solution[0] - step) <= _EXACT:
            return float(step)
    return float(steps[-1])


@numba.njit(cache=True, inline='always')
def _place(row):  # type: ignore[no-untyped-def]
    """Return whole pixel and lattice cell of a position."""
    x, y = math.floor(row[X] + 0.5), math.floor(row[Y] + 0.5)
    i = min(int((row[X] - x + 0.5) * _CELLS), _CELLS - 1)
    j = min(int((row[Y] - y + 0.5) * _CELLS), _CELLS - 1)
    return int(x), int(y), i, j


@numba.njit(cache=True, fastmath=FAST)
def _gather(image, grid, spacing, x, y, window):  # type: ignore[no-untyped-def]
    """Fill a window about the pixel (x, y) with grey minus background, NaN beyond the picture.

    Returns whether any pixel is NaN.
    """
    rows, columns = window.shape
    half = rows // 2
    height, width = image.shape
    left = background_at(grid, spacing, float(x - half), float(y))
    right = background_at(grid, spacing, float(x + half), float(y))
    above = background_at(grid, spacing, float(x), float(y - half))
    below = background_at(grid, spacing, float(x), float(y + half))
    step_x, step_y = np.float32((right - left) / (2 * half)), (below - above) / (2 * half)
    start = (left + right + above + below) / 4 - (step_x + step_y) * half
    if half <= x < width - columns + half and half <= y < height - half:
        # Unsigned indices cannot wrap around, which lets the compiler vectorise.
        from_x = numba.uintp(x - half)
        for dy in range(rows):
            light = np.float32(start + step_y * dy)
            py, wy = numba.uintp(y - half + dy), numba.uintp(dy)
            for k in range(numba.uintp(columns)):
                grey = np.float32(image[py, from_x + k])
                window[wy, k] = grey - light - step_x * np.float32(k)
        return False
    for dy in range(rows):
        py = y - half + dy
        for k in range(columns):
            px = x - half + k
            window[dy, k] = np.nan
            if 0 <= py < height and 0 <= px < width:
                window[dy, k] = image[py, px] - start - step_y * dy - step_x * k
    return True


@numba.njit(cache=True, fastmath=FAST)
def _take_away(window, x, y, other, pictures):  # type: ignore[no-untyped-def]
    """Subtract another particle from the window centred at the pixel (x, y)."""
    other_x, other_y, i, j = _place(other)
    picture = pictures[j, i]
    rows, columns = picture.shape
    margin = (rows - window.shape[0]) // 2
    dx, dy = x - other_x + margin, y - other_y + margin
    contrast = np.float32(other[CONTRAST])
    first, last = max(0, -dx), min(window.shape[1], columns - dx)
    from_x, to_x = numba.uintp(first + dx), numba.uintp(first)
    for row in range(max(0, -dy), min(window.shape[0], rows - dy)):
        from_y, to_y = numba.uintp(row + dy), numba.uintp(row)
        for k in range(numba.uintp(max(last - first, 0))):
            window[to_y, to_x + k] -= contrast * picture[from_y, from_x + k]


@numba.njit(cache=True, fastmath=FAST)
def _project(window, design, overlap):  # type: ignore[no-untyped-def]
    """Write overlaps of the window with the rows of the design; return its sum of squares."""
    f0, f1, f2, f3, disc = design[0], design[1], design[2], design[3], design[4]
    a = b = c = d = e = squares = np.float32(0.0)
    for m in range(window.size):
        value = window[m] * disc[m]
        a += f0[m] * value
        b += f1[m] * value
        c += f2[m] * value
        d += f3[m] * value
        e += value
        squares += value * value
    overlap[0], overlap[1], overlap[2], overlap[3], overlap[4] = a, b, c, d, e
    return squares


@numba.njit(cache=True, fastmath=FAST)
def _dot(one, weight, other):  # type: ignore[no-untyped-def]
    total = np.float32(0.0)
    for m in range(one.size):
        total += one[m] * weight[m] * other[m]
    return total


@numba.njit(cache=True, fastmath=FAST)
def _project_part(window, design, whole, overlap, covariance):  # type: ignore[no-untyped-def]
    """Apply `_project` to the pixels that are not NaN, with their covariance (5, 5).

    Also returns the number of pixels, 0 if they are too few of the `whole`.
    """
    disc, value = design[4].copy(), window.copy()
    for m in range(window.size):
        if math.isnan(window[m]):
            disc[m], value[m] = 0, 0
    for k in range(5):
        overlap[k] = _dot(design[k], disc, value)
        for n in range(k + 1):
            covariance[k, n] = _dot(design[k], disc, design[n])
    squares, pixels = _dot(value, disc, value), np.sum(disc)
    enough = pixels >= _LEAST_IN_VIEW * whole and invert(covariance)
    return squares, pixels if enough else 0.0


@numba.njit(cache=True, fastmath=FAST)
def _solve(covariance, overlap, solution):  # type: ignore[no-untyped-def]
    """Write the linear solution (5,); return the sum of squares that it explains."""
    explained = 0.0
    for m in range(5):
        total = 0.0
        for n in range(5):
            total += covariance[m, n] * overlap[n]
        solution[m] = total
        explained += total * overlap[m]
    return explained


@numba.njit(cache=True, fastmath=FAST)
def _update(row, solution, i, j, x, y):  # type: ignore[no-untyped-def]
    """Set parameters from the linear solution about the centre of a cell."""
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


@numba.njit(cache=True, fastmath=FAST)
def _conclude(row, squares, pixels, covariance, errors):  # type: ignore[no-untyped-def]
    variance = squares / (pixels - 5)
    contrast = max(abs(row[CONTRAST]), 1e-6)
    errors[CONTRAST] = math.sqrt(variance * covariance[0, 0])
    errors[X] = math.sqrt(variance * covariance[1, 1]) / contrast
    errors[Y] = math.sqrt(variance * covariance[2, 2]) / contrast
    errors[SIZE] = math.sqrt(variance * covariance[3, 3]) / contrast
    errors[OFFSET] = math.sqrt(variance * covariance[4, 4])
    errors[PARAMETERS] = variance
    errors[PARAMETERS + 1] = pixels


@numba.njit(cache=True, inline='always')
def _turn(row, flat, cut, tables, overlap, solution, covariance):  # type: ignore[no-untyped-def]
    """Fit a particle to a window about its present cell; `covariance` (5, 5) receives its own.

    Returns the residual sum of squares, the number of pixels (0 if too few), and the distance from
    the middle of the cell.
    """
    x, y, i, j = _place(row)
    if cut:
        total, pixels = _project_part(
            flat, tables.design[j, i], tables.pixels[j, i], overlap, covariance)
        if pixels == 0:
            return -1.0, 0.0, 0.0
    else:
        total, pixels = _project(flat, tables.design[j, i], overlap), tables.pixels[j, i]
        covariance[:] = tables.covariance[j, i]
    squares = max(total - _solve(covariance, overlap, solution), 0.0)
    _update(row, solution, i, j, x, y)
    off_x, off_y = row[X] - x - (i + 0.5) / _CELLS + 0.5, row[Y] - y - (j + 0.5) / _CELLS + 0.5
    return squares, pixels, max(abs(off_x), abs(off_y))


@numba.njit(cache=True)
def _sweep(  # type: ignore[no-untyped-def]
        image, grid, spacing, parameters, waiting, first, other, settled, tables, squares, pixels,
        covariance):
    """Refit each waiting particle; one alone is then done, others once they hold still.

    The last three (N, ...) receive the inputs of `_conclude`: no `pixels` for particles not in the
    picture, or too little.
    """
    height, width = image.shape
    window = np.empty(tables.window, np.float32)
    flat, overlap, solution = window.reshape(-1), np.empty(5), np.empty(5)
    for n in range(len(parameters)):
        if not waiting[n]:
            continue
        row = parameters[n]
        alone, cut = first[n] == first[n + 1], False
        before_x, before_y = row[X], row[Y]
        at_x, at_y, turns = -1, -1, 0
        while turns < ((_TURNS_CUT if cut else _TURNS) if alone else 1):
            turns += 1
            x, y, _, _ = _place(row)
            if x != at_x or y != at_y:
                at_x, at_y = x, y
                cut = _gather(image, grid, spacing, x, y, window)
                for k in range(first[n], first[n + 1]):
                    _take_away(window, x, y, parameters[other[k]], tables.picture)
            squares[n], pixels[n], off = _turn(
                row, flat, cut, tables, overlap, solution, covariance[n])
            if pixels[n] == 0 or not (
                    -0.5 <= row[X] < width - 0.5 and -0.5 <= row[Y] < height - 0.5):
                row[X], row[Y], row[CONTRAST] = x, y, 0.0
                pixels[n] = 0
                break
            if off <= settled:
                break
        moved = max(abs(row[X] - before_x), abs(row[Y] - before_y))
        waiting[n] = not alone and pixels[n] > 0 and moved > _SETTLED_AMONG_OTHERS


@numba.njit(cache=True)
def _fit(image, grid, spacing, parameters, active, near, settled, tables):  # type: ignore[no-untyped-def]
    count = len(parameters)
    errors = np.full((count, PARAMETERS + 2), np.nan)
    squares, pixels, covariance = np.empty(count), np.zeros(count), np.empty((count, 5, 5))
    waiting = active.copy()
    first, other = neighbours(parameters, near)
    for _ in range(_TURNS_AMONG_OTHERS):
        _sweep(image, grid, spacing, parameters, waiting, first, other, settled, tables, squares,
               pixels, covariance)
    for n in range(count):
        if pixels[n] > 0:
            _conclude(parameters[n], squares[n], pixels[n], covariance[n], errors[n])
    return errors
