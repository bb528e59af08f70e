"""Maximum-likelihood position, contrast, size and cap direction of particles in a picture.

A particle is modelled as background + b + a·[f₀(r/s) + f₁(r/s) cos(φ−θ) + f₂(r/s) cos 2(φ−θ)]
about its centre (x, y), with the radial profiles f of `Appearance`. Gauss–Newton on the squared
residual is maximum likelihood for Gaussian noise; overlapping particles are fitted in turn, each
to the residual of the others, until they converge.

Parameters of a particle, in this order: x, y [px], contrast a and offset b [grey], relative size
s, cap direction θ [rad].
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba

X, Y, CONTRAST, OFFSET, SIZE, THETA = range(6)
PARAMETERS = 6  # their number

TABLE_STEP = 1 / 16
"""Choice: spacing [px] of the profile tables; interpolation errs by 1e-4 of the contrast."""

FAST = {'reassoc', 'contract', 'arcp', 'nsz'}
"""Liberties of fast arithmetic except one: NaN and infinity keep their meaning."""

# Choices: bounds of the relative size, and the longest step [px], for starts far off.
_SMALLEST, _LARGEST, _LONGEST_STEP = 0.4, 2.5, 1.0


@numba.njit(cache=True, fastmath=FAST, inline='always')
def _profile(table, harmonic, r):  # type: ignore[no-untyped-def]
    """Return value and radial derivative of one profile; zero beyond the table."""
    position = r * (1 / TABLE_STEP)
    k = int(position)
    if k + 1 >= table.shape[1]:
        return 0.0, 0.0
    low = table[harmonic, k]
    slope = table[harmonic, k + 1] - low
    return low + slope * (position - k), slope * (1 / TABLE_STEP)


@numba.njit(cache=True, fastmath=FAST)
def _model(parameters, table, u, v):  # type: ignore[no-untyped-def]
    """Return what a particle adds to the background at an offset (u, v) from its centre.

    A neighbour without a known cap direction counts as round.
    """
    r = math.sqrt(u * u + v * v) / parameters[SIZE]
    value = _profile(table, 0, r)[0]
    if table.shape[0] > 1 and r > 0 and math.isfinite(parameters[THETA]):
        c = math.cos(math.atan2(v, u) - parameters[THETA])
        value += _profile(table, 1, r)[0] * c
        value += _profile(table, 2, r)[0] * (2 * c * c - 1)
    return parameters[CONTRAST] * value


@numba.njit(cache=True, fastmath=FAST)
def background_at(grid, spacing, x, y):  # type: ignore[no-untyped-def]
    """Return the background at a point `x`, `y` [px], bilinear between the centres of cells.

    `grid` (h, w) holds the background of each cell of `spacing` px.

    Parameters
    ----------
    grid : ndarray, shape (h, w)
        Background of each cell [grey].
    spacing
        Size of a cell [px].
    x
        Column [px].
    y
        Row [px].
    """
    gx = min(max((x + 0.5) / spacing - 0.5, 0.0), grid.shape[1] - 1.0)
    gy = min(max((y + 0.5) / spacing - 0.5, 0.0), grid.shape[0] - 1.0)
    i, j = int(gx), int(gy)
    i2, j2 = min(i + 1, grid.shape[1] - 1), min(j + 1, grid.shape[0] - 1)
    fx, fy = gx - i, gy - j
    top = grid[j, i] * (1 - fx) + grid[j, i2] * fx
    return top * (1 - fy) + (grid[j2, i] * (1 - fx) + grid[j2, i2] * fx) * fy


@numba.njit(cache=True, fastmath=FAST)
def _window(image, grid, spacing, parameters, i, neighbours, table, reach, pixels):  # type: ignore[no-untyped-def]
    """Fill `pixels` (3, ·) with x, y and grey minus background and neighbours."""
    row = parameters[i]
    x0, y0 = math.floor(row[X] + 0.5), math.floor(row[Y] + 0.5)
    span = int(reach) + 1
    count = 0
    for y in range(max(y0 - span, 0), min(y0 + span + 1, image.shape[0])):
        for x in range(max(x0 - span, 0), min(x0 + span + 1, image.shape[1])):
            if (x - row[X]) ** 2 + (y - row[Y]) ** 2 > reach * reach:
                continue
            grey = float(image[y, x]) - background_at(grid, spacing, x, y)
            for j in neighbours:
                other = parameters[j]
                grey -= _model(other, table, x - other[X], y - other[Y])
            pixels[0, count], pixels[1, count], pixels[2, count] = x, y, grey
            count += 1
    return count


@numba.njit(cache=True, fastmath=FAST)
def _accumulate(row, table, pixels, count, free, normal, gradient, columns):  # type: ignore[no-untyped-def]
    """Write the normal equations of one Gauss–Newton step; return the sum of squared residuals.

    `columns` (7, ·) is a buffer for derivatives and residual at each pixel.
    """
    a, s = row[CONTRAST], row[SIZE]
    cos_theta, sin_theta = math.cos(row[THETA]), math.sin(row[THETA])
    for k in range(count):
        u, v = pixels[0, k] - row[X], pixels[1, k] - row[Y]
        distance = math.sqrt(u * u + v * v)
        scale = 1 / max(distance, 1e-9)
        ex, ey = u * scale, v * scale
        r = distance / s
        value, slope = _profile(table, 0, r)
        turn = 0.0
        if free > THETA:
            c1 = ex * cos_theta + ey * sin_theta
            s1 = ey * cos_theta - ex * sin_theta
            c2, s2 = c1 * c1 - s1 * s1, 2 * c1 * s1
            one, one_slope = _profile(table, 1, r)
            two, two_slope = _profile(table, 2, r)
            value += one * c1 + two * c2
            slope += one_slope * c1 + two_slope * c2
            turn = a * (one * s1 + 2 * two * s2)
        radial, tangential = a * slope / s, -turn * scale
        columns[X, k] = tangential * ey - radial * ex
        columns[Y, k] = -(radial * ey + tangential * ex)
        columns[CONTRAST, k] = value
        columns[OFFSET, k] = 1.0
        columns[SIZE, k] = -radial * r
        columns[THETA, k] = turn
        columns[PARAMETERS, k] = pixels[2, k] - row[OFFSET] - a * value
    residual = columns[PARAMETERS, :count]
    for m in range(free):
        gradient[m] = _dot(columns[m, :count], residual)
        for n in range(m + 1):
            normal[m, n] = _dot(columns[m, :count], columns[n, :count])
    return _dot(residual, residual)


@numba.njit(cache=True, fastmath=FAST)
def _dot(one, other):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


@numba.njit(cache=True, fastmath=FAST)
def _factor(normal, free):  # type: ignore[no-untyped-def]
    """Factor in place (Cholesky, lower); False if the parameters are not determined."""
    for m in range(free):
        for n in range(m + 1):
            value = normal[m, n]
            for k in range(n):
                value -= normal[m, k] * normal[n, k]
            if m == n:
                if not value > 1e-12:
                    return False
                normal[m, m] = math.sqrt(value)
            else:
                normal[m, n] = value / normal[n, n]
    return True


@numba.njit(cache=True, fastmath=FAST)
def _solve(factor, free, vector):  # type: ignore[no-untyped-def]
    for m in range(free):
        for k in range(m):
            vector[m] -= factor[m, k] * vector[k]
        vector[m] /= factor[m, m]
    for m in range(free - 1, -1, -1):
        for k in range(m + 1, free):
            vector[m] -= factor[k, m] * vector[k]
        vector[m] /= factor[m, m]


@numba.njit(cache=True, fastmath=FAST)
def invert(normal):  # type: ignore[no-untyped-def]
    """Invert a symmetric positive `normal` (n, n) in place, of which the lower half is read.

    Returns False, leaving it undefined, if the picture does not determine the parameters.

    Parameters
    ----------
    normal : ndarray, shape (n, n)
        The matrix.
    """
    factor = normal.copy()
    if not _factor(factor, len(normal)):
        return False
    for m in range(len(normal)):
        normal[m] = 0.0
        normal[m, m] = 1.0
        _solve(factor, len(normal), normal[m])
    return True


@numba.njit(cache=True, fastmath=FAST)
def _point_cap(row, table, pixels, count):  # type: ignore[no-untyped-def]
    """Estimate a first cap direction from the asymmetry of the round part's residual."""
    along, across = 0.0, 0.0
    for k in range(count):
        u, v = pixels[0, k] - row[X], pixels[1, k] - row[Y]
        distance = max(math.sqrt(u * u + v * v), 1e-9)
        r = distance / row[SIZE]
        residual = pixels[2, k] - row[OFFSET] - row[CONTRAST] * _profile(table, 0, r)[0]
        weight = residual * _profile(table, 1, r)[0] * row[CONTRAST] / distance
        along += weight * u
        across += weight * v
    row[THETA] = math.atan2(across, along)


@numba.njit(cache=True, fastmath=FAST)
def _step(row, change, free):  # type: ignore[no-untyped-def]
    """Apply a bounded step: far from the solution the linear model overshoots."""
    length = math.sqrt(change[X] ** 2 + change[Y] ** 2)
    if length > _LONGEST_STEP:
        change[X] *= _LONGEST_STEP / length
        change[Y] *= _LONGEST_STEP / length
    for m in range(free):
        row[m] += change[m]
    row[SIZE] = min(max(row[SIZE], _SMALLEST), _LARGEST)


@numba.njit(cache=True, fastmath=FAST)
def _fit_one(  # type: ignore[no-untyped-def]
        row, table, pixels, count, iterations, capped, errors, columns, work):
    """Fit one particle; `errors` gets σ of each parameter [its unit] and the residual variance."""
    normal, gradient = work[:PARAMETERS], work[PARAMETERS]
    errors[:] = np.nan
    for turn in range(iterations):
        free = PARAMETERS if capped and turn >= 1 else THETA
        if free == PARAMETERS and turn == 1 and not math.isfinite(row[THETA]):
            _point_cap(row, table, pixels, count)
        total = _accumulate(row, table, pixels, count, free, normal, gradient, columns)
        if not _factor(normal, free):
            return False
        _solve(normal, free, gradient)
        _step(row, gradient, free)
    free = PARAMETERS if capped else THETA
    total = _accumulate(row, table, pixels, count, free, normal, gradient, columns)
    covariance = normal[:free, :free].copy()
    if not invert(covariance):
        return False
    variance = total / max(count - free, 1)
    for m in range(free):
        errors[m] = math.sqrt(variance * covariance[m, m])
    errors[PARAMETERS] = variance
    errors[PARAMETERS + 1] = count
    return True


@numba.njit(cache=True, fastmath=FAST)
def fit(image, grid, spacing, parameters, active, table, reach, iterations, sweeps):  # type: ignore[no-untyped-def]
    """Fit all particles of a picture, in place.

    A particle that the picture does not determine has NaN errors throughout.

    Parameters
    ----------
    image : (H, W) array
        Grey values of the picture.
    grid : (h, w) array
        Background in cells of `spacing` px.
    spacing : int
        Width of a cell of the background [px].
    parameters : (N, 6) array
        Start values (θ NaN: found from the picture), replaced by the fit.
    active : (N,) bool array
        Particles to fit; others are only drawn as neighbours.
    table : (1 or 3, K) array
        Profiles in steps of `TABLE_STEP` px.
    reach : float
        Radius of the fitted disc [px].
    iterations, sweeps : int
        Gauss–Newton steps of a particle, and turns of particles with neighbours in reach.

    Returns
    -------
    (N, 8) array
        Standard deviation of each parameter from the residual (NaN if there is none), variance of
        the residual [grey²], number of pixels.
    """
    count = parameters.shape[0]
    errors = np.full((count, PARAMETERS + 2), np.nan)
    width = 2 * int(reach) + 3
    pixels = np.empty((3, width * width))
    columns = np.empty((PARAMETERS + 1, width * width))
    work = np.empty((PARAMETERS + 1, PARAMETERS))
    capped = table.shape[0] > 1
    neighbours = np.empty(count, np.int64)
    for sweep in range(sweeps):
        for i in range(count):
            if not active[i]:
                continue
            row = parameters[i]
            near = 0
            for j in range(count):
                limit = reach * (1 + parameters[j, SIZE])
                if j != i and abs(parameters[j, X] - row[X]) < limit \
                        and abs(parameters[j, Y] - row[Y]) < limit:
                    neighbours[near] = j
                    near += 1
            if sweep > 0 and near == 0:
                continue
            if not (-0.5 <= row[X] < image.shape[1] - 0.5
                    and -0.5 <= row[Y] < image.shape[0] - 0.5):
                errors[i] = np.nan
                continue
            filled = _window(
                image, grid, spacing, parameters, i, neighbours[:near], table, reach, pixels)
            if filled < 0.4 * math.pi * reach * reach or not _fit_one(
                    row, table, pixels, filled, iterations, capped, errors[i], columns, work):
                errors[i] = np.nan
                row[CONTRAST] = 0.0
    return errors


@numba.njit(cache=True)
def background_of(grid, spacing, x, y):  # type: ignore[no-untyped-def]
    """Return the background at points `x`, `y` (N,) [px].

    `grid` and `spacing` as in `background_at`.

    Parameters
    ----------
    grid : ndarray, shape (h, w)
        Background of each cell [grey].
    spacing
        Size of a cell [px].
    x : ndarray, shape (N,)
        Columns [px].
    y : ndarray, shape (N,)
        Rows [px].
    """
    light = np.empty(len(x))
    for k in range(len(x)):
        light[k] = background_at(grid, spacing, float(x[k]), float(y[k]))
    return light
