"""Precise positions of round bodies of any size: a disc with a soft edge is fitted to each.

Grey = b + h / (1 + exp((r − R)/s)), r the distance from (x, y): least squares in all six by
Gauss–Newton, which for Gaussian noise reaches the Cramér–Rao bound of the position. If the disc
does not explain the body, the centroid is kept.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba

_ROUND = 1.35
"""Choice: largest length over width that is fitted."""

_EXPLAINED = 0.93
"""Choice: least share of the picture that the disc must explain, noise taken into account."""

_CLEAR = 5.0
"""Choice: least contrast of the disc over the noise, all its pixels together."""

_REACH = 3.0
"""Choice: edge parameters s beyond the radius that are included."""

_STEPS, _SETTLED = 12, 2e-3  # choices: most steps, and the step [px] that ends the fit

_ASTRAY, _ASTRAY_CUT = 0.3, 1.0
"""Choices: radii by which a fit may leave the centroid, and that of a body cut by the edge."""


@numba.njit(cache=True, nogil=True)
def refine(image, xy, radius, edge, height, length, cut, noise):  # type: ignore[no-untyped-def]
    """Fit discs to bodies and return positions (N, 2) [px], σ (N,) and whether each fits (N,).

    If no disc fits, the position is `xy` and σ NaN.

    Parameters
    ----------
    image : (H, W) array
        Grey values of the picture.
    xy : (N, 2) array [px]
        Centroids of the bodies.
    radius, edge : (N,) array [px]
        Radius of each body and width of its edge, from which the fit starts.
    height : (N,) array [grey]
        Signed contrast.
    length : (N,) array
        Length over width.
    cut : (N,) bool array
        Whether the edge of the picture cuts the body, so that neither position nor length are the
        disc's.
    noise : float
        Pixel noise [grey].

    Returns
    -------
    tuple[ndarray, ndarray, ndarray]
        Positions (N, 2) [px], σ (N,) [px] and whether each fits (N,).
    """
    places, sigma = xy.copy(), np.full(len(xy), np.nan)
    fitted = np.zeros(len(xy), np.bool_)
    row = np.empty(6)
    for n in range(len(xy)):
        if length[n] > _ROUND and not cut[n]:
            continue
        row[:] = (xy[n, 0], xy[n, 1], height[n], 0.0, radius[n], max(edge[n] / 2, 0.3))
        error = _fit(image, row, noise)
        off = math.hypot(row[0] - xy[n, 0], row[1] - xy[n, 1])
        near = off < (_ASTRAY_CUT if cut[n] else _ASTRAY) * radius[n]
        if error > 0 and near and row[2] * height[n] > 0:
            places[n, 0], places[n, 1], sigma[n], fitted[n] = row[0], row[1], error, True
    return places, sigma, fitted


@numba.njit(cache=True, nogil=True)
def _fit(image, row, noise):  # type: ignore[no-untyped-def]
    """Fit `row` = x, y, h, b, R, s in place; return σ of x and y [px], −1 without a fit."""
    normal, gradient, slopes = np.empty((6, 6)), np.empty(6), np.empty(6)
    reach = row[4] + _REACH * row[5] + 1.5
    box = _window(image.shape, row, reach)
    if box[1] - box[0] < 5 or box[3] - box[2] < 5:
        return -1.0
    row[3] = _rim(image, row, box)
    for _ in range(_STEPS):
        count, squares, energy = _accumulate(image, row, box, reach, normal, gradient, slopes)
        if not math.isfinite(squares + energy):
            return -1.0
        step = np.linalg.solve(normal, gradient)
        size = math.hypot(step[0], step[1])
        share = min(1.0, 0.3 * row[4] / max(size, 1e-12), 0.5 * row[4] / max(abs(step[4]), 1e-12),
                    0.5 * row[5] / max(abs(step[5]), 1e-12))
        row += share * step
        if not (math.isfinite(row[0]) and math.isfinite(row[5])) or row[4] < 1 or row[5] < 0.05:
            return -1.0
        if size < _SETTLED and share == 1.0:
            break
    count, squares, energy = _accumulate(image, row, box, reach, normal, gradient, slopes)
    left = max(squares - count * noise * noise, 0.0)
    if count < 12 or energy < (_CLEAR * noise) ** 2:
        return -1.0
    if not left <= (1 - _EXPLAINED) * energy < math.inf:
        return -1.0
    variance = max(squares / (count - 6), noise * noise)
    inverse = np.linalg.inv(normal)
    return math.sqrt(variance * (inverse[0, 0] + inverse[1, 1]) / 2)


@numba.njit(cache=True, nogil=True)
def _window(shape, row, reach):  # type: ignore[no-untyped-def]
    """Return first and last rows and columns within `reach` [px] of a body."""
    return (max(int(row[1] - reach), 0), min(int(row[1] + reach) + 2, shape[0]),
            max(int(row[0] - reach), 0), min(int(row[0] + reach) + 2, shape[1]))


@numba.njit(cache=True, nogil=True)
def _rim(image, row, box):  # type: ignore[no-untyped-def]
    """Return the mean grey in the outermost pixel width of the window, a first background."""
    reach = row[4] + _REACH * row[5]
    total, count = 0.0, 0
    for y in range(box[0], box[1]):
        for x in range(box[2], box[3]):
            r = math.hypot(x - row[0], y - row[1])
            if reach <= r < reach + 1.5:
                total += image[y, x]
                count += 1
    return total / max(count, 1)


@numba.njit(cache=True, nogil=True)
def _accumulate(image, row, box, reach, normal, gradient, slopes):  # type: ignore[no-untyped-def]
    """Write the normal equations about `row`; return pixels, squared residual, energy of the disc.

    The energy is about its mean: what there is to explain. The matrix is never singular.
    """
    normal[:] = 0
    gradient[:] = 0
    x0, y0, height, light, radius, soft = row
    count, squares, total, energy = 0, 0.0, 0.0, 0.0
    slopes[3] = 1.0
    for y in range(box[0], box[1]):
        for x in range(box[2], box[3]):
            u, v = x - x0, y - y0
            r = math.hypot(u, v)
            if r > reach:
                continue
            q = min(max((radius - r) / soft, -40.0), 40.0)
            f = 1 / (1 + math.exp(-q))
            steep = height * f * (1 - f) / soft
            away = max(r, 1e-9)
            slopes[0], slopes[1], slopes[2] = steep * u / away, steep * v / away, f
            slopes[4], slopes[5] = steep, -steep * q
            residual = image[y, x] - light - height * f
            count += 1
            squares += residual * residual
            total += height * f
            energy += (height * f) ** 2
            for j in range(6):
                gradient[j] += slopes[j] * residual
                for k in range(j + 1):
                    normal[j, k] += slopes[j] * slopes[k]
    for j in range(6):
        for k in range(j):
            normal[k, j] = normal[j, k]
        # Regularised, so that undetermined parameters do not make the matrix singular.
        normal[j, j] += 1e-9 * normal[j, j] + 1e-12
    return count, squares, energy - total * total / max(count, 1)
