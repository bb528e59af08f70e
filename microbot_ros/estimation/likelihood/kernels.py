"""Compiled loops over frames: whitening and filtering. Imported only where needed.

All assume D = 1: `noise_ratio` [s] is σ²/D less a third of the exposure (see `noise`). They use
loops instead of slices, which take seconds longer to compile. Helpers of the filter with headings
are inlined: it takes twice as long if a covariance of ten numbers passes through memory.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.model.physics.alignment_kernel import given

_ROWS = f"{given('float64', 1, 'C')}, {given('int64', 2, 'C')}"
"""Types of `times` and `pieces`."""
_COLUMNS, _TURNS = given('complex128', 3, 'C'), given('complex128', 2, 'C')
"""Types of columns, and of sensitivities and scatter."""
_RETENTION = given('float64', 2, 'C')
"""Type of `retention`, and of the covariances' increments."""

_KEPT: dict[str, Any] = {'cache': True, 'error_model': 'numpy'}
"""Options of all loops. Without a check of every division they take 15 % less time."""


@numba.njit([f"({_ROWS}, {given(kind, 3, 'C')}, float64)" for kind in ('complex128', 'float64')],
            **_KEPT)
def whiten_columns(times, pieces, columns, noise_ratio):  # type: ignore[no-untyped-def]
    """Whiten columns by the gain of the local-level model.

    Parameters
    ----------
    times : ndarray, shape (T,)
        Times of the frames [s].
    pieces : ndarray of int, shape (T, N)
        Piece of the track that each row belongs to; 0 for unused rows.
    columns : ndarray, shape (T, N, M)
        Real or complex positions or displacements.
    noise_ratio : float
        σ²/D less a third of the exposure [s].

    Returns
    -------
    out : ndarray, shape (T, N, M)
        Increments of unit variance per axis; 0 in unused rows and the first row of each piece.
    log_det : float
        Σ log variance of one axis; for complex columns ½ log det over both axes.
    used : int
        Rows used.
    """
    frames, tracks, count = columns.shape
    out = np.zeros_like(columns)
    filtered = np.zeros(count, columns.dtype)
    log_det, used = 0.0, 0
    for n in range(tracks):
        last, piece = -1, 0
        variance = noise_ratio
        for k in range(frames):
            if not pieces[k, n]:
                continue
            if pieces[k, n] != piece:
                piece, variance = pieces[k, n], noise_ratio
                for m in range(count):
                    filtered[m] = columns[k, n, m]
            else:
                ahead = variance + 2.0 * (times[k] - times[last])
                total = ahead + noise_ratio
                gain = ahead / total
                scale = 1.0 / np.sqrt(total)
                for m in range(count):
                    innovation = columns[k, n, m] - filtered[m]
                    filtered[m] += gain * innovation
                    out[k, n, m] = innovation * scale
                variance = noise_ratio * gain
                log_det += np.log(total)
                used += 1
            last = k
    return out, log_det, used


@numba.njit(**_KEPT)
def whitened_products(times, pieces, z, offset, along, noise_ratio):  # type: ignore[no-untyped-def]
    """Return inner products of whitened data and columns, without storing these.

    Parameters
    ----------
    times, pieces, noise_ratio
        As for `whiten_columns`.
    z : ndarray of complex, shape (T, N)
        Positions [m].
    offset, along : ndarray of complex, shape (T, 1 or N)
        Displacement by drift [m], and per unit v e^{iφ} [s].

    Returns
    -------
    products : ndarray, shape (N, 3, 3)
        Real inner products of `z` − `offset`, `along` and i·`along`.
    log_det : float
        ½ log det over both axes.
    used : int
        Rows used.
    """
    frames, tracks = z.shape
    products, log_det, used = np.zeros((tracks, 3, 3)), 0.0, 0
    for n in range(tracks):
        o, a = min(n, offset.shape[1] - 1), min(n, along.shape[1] - 1)
        data = column = mixed = 0j
        own = power = 0.0
        last, piece, variance, total_product = -1, 0, noise_ratio, 1.0
        for k in range(frames):
            if not pieces[k, n]:
                continue
            new, way = z[k, n] - offset[k, o], along[k, a]
            if pieces[k, n] != piece:
                piece, variance = pieces[k, n], noise_ratio
                data, column = new, way
            else:
                ahead = variance + 2.0 * (times[k] - times[last])
                weight = 1.0 / (ahead + noise_ratio)
                gain = ahead * weight
                new, way = new - data, way - column
                data += gain * new
                column += gain * way
                own += (new.real * new.real + new.imag * new.imag) * weight
                power += (way.real * way.real + way.imag * way.imag) * weight
                mixed += new * way.conjugate() * weight
                variance = noise_ratio * gain
                # One logarithm for many, for it costs as much as all the rest.
                total_product *= ahead + noise_ratio
                if not 1e-250 < total_product < 1e250:
                    log_det += math.log(total_product)
                    total_product = 1.0
                used += 1
            last = k
        log_det += math.log(total_product)
        gram = products[n]
        gram[0, 0], gram[1, 1], gram[2, 2] = own, power, power
        gram[0, 1] = gram[1, 0] = mixed.real
        gram[0, 2] = gram[2, 0] = mixed.imag
    return products, log_det, used


@numba.njit(f'({_COLUMNS}, {_COLUMNS}, float64)', **_KEPT)
def joint_products(white, others, scale):  # type: ignore[no-untyped-def]
    """Return inner products of two groups of whitened columns together.

    Parameters
    ----------
    white : ndarray of complex, shape (T, N, L)
        First columns.
    others : ndarray of complex, shape (T, N, M)
        Further columns.
    scale : float
        Factor on the first columns.

    Returns
    -------
    ndarray, shape (N, L + M, L + M)
        Real inner products, by track.
    """
    frames, tracks, count = white.shape
    total = count + others.shape[2]
    out, row = np.zeros((tracks, total, total)), np.zeros(total, np.complex128)
    for k in range(frames):
        for n in range(tracks):
            for m in range(count):
                row[m] = white[k, n, m] * scale
            for m in range(count, total):
                row[m] = others[k, n, m - count]
            for m in range(total):
                x, y = row[m].real, row[m].imag
                for other in range(m + 1):
                    out[n, m, other] += x * row[other].real + y * row[other].imag
    for n in range(tracks):
        for m in range(total):
            for other in range(m):
                out[n, other, m] = out[n, m, other]
    return out


FOLLOWED = 1e-12
"""Fraction of the largest step below which the unfiltered rest of a step counts as 0.

Choice: far above rounding, far below any effect on a product.
"""


@numba.njit(**_KEPT)
def _steps_of_row(left, active, number, knots, moved):  # type: ignore[no-untyped-def]
    """Add what the next interval has `moved` to each knot; return how many knots are active."""
    for j in range(len(knots)):
        m = knots[j]
        if moved[j] != 0:
            known = False
            for a in range(number):
                known = known or active[a] == m
            if not known:
                active[number] = m
                number += 1
            left[m] += moved[j]
    return number


@numba.njit(**_KEPT)
def _add_products(gram, known, left, active, scale):  # type: ignore[no-untyped-def]
    """Add the products of one row, below the diagonal: `known` columns, then `active` knots."""
    first = len(known)
    for a in range(first):
        for b in range(a + 1):
            gram[a, b] += known[a].real * known[b].real + known[a].imag * known[b].imag
    for a in range(len(active)):
        m = active[a]
        x, y = left[m].real * scale, left[m].imag * scale
        for b in range(first):
            gram[first + m, b] += x * known[b].real + y * known[b].imag
        for b in range(a + 1):
            other = active[b]
            product = (x * left[other].real + y * left[other].imag) * scale
            gram[first + max(m, other), first + min(m, other)] += product


@numba.njit(**_KEPT)
def knot_products(  # type: ignore[no-untyped-def]
        times, pieces, known, starts, knots, moved, count, folds, parts, noise_ratio):
    """Return inner products of known columns and knots for one track, whitened.

    Parameters
    ----------
    times, noise_ratio
        As for `whiten_columns`.
    pieces : ndarray of int, shape (T,)
        Piece of the track that each row belongs to; 0 for unused rows.
    known : ndarray of complex, shape (T, L)
        Columns that are whitened already.
    starts, knots, moved : ndarray
        Displacements in sparse rows: in the interval after row k, `knots[starts[k]:starts[k + 1]]`
        are `moved`.
    count : int
        Number of knots.
    folds : ndarray of int, shape (T,)
        Fold of each row.
    parts : int
        Number of folds.

    Returns
    -------
    ndarray, shape (parts, L + count, L + count)
        Real inner products, by fold.
    """
    first = known.shape[1]
    out = np.zeros((parts, first + count, first + count))
    left, active, number = np.zeros(count, np.complex128), np.zeros(count, np.int64), 0
    least = FOLLOWED * np.abs(moved).max() if len(moved) else 0.0
    last, piece, variance = -1, 0, noise_ratio
    for k in range(len(times)):
        if k:
            told = slice(starts[k - 1], starts[k])
            number = _steps_of_row(left, active, number, knots[told], moved[told])
        if not pieces[k]:
            continue
        kept = 0.0
        if pieces[k] != piece:
            piece, variance = pieces[k], noise_ratio
        else:
            ahead = variance + 2.0 * (times[k] - times[last])
            total = ahead + noise_ratio
            kept = noise_ratio / total
            _add_products(out[folds[k]], known[k], left, active[:number], 1.0 / math.sqrt(total))
            variance = noise_ratio * ahead / total
        last, held = k, 0
        for a in range(number):
            m = active[a]
            left[m] *= kept
            if abs(left[m]) > least:
                active[held] = m
                held += 1
            else:
                left[m] = 0j
        number = held
    for gram in out:
        for a in range(len(gram)):
            for b in range(a):
                gram[b, a] = gram[a, b]
    return out


@numba.njit(**_KEPT)
def filter_positions(times, pieces, positions, noise_ratio):  # type: ignore[no-untyped-def]
    """Filter positions with the local-level model.

    Parameters
    ----------
    times, pieces, noise_ratio
        As for `whiten_columns`. The filter restarts with every piece.
    positions : ndarray of complex, shape (T, N)
        Positions [m].

    Returns
    -------
    ndarray of complex, shape (T, N)
        Means after every frame [m]. NaN before the first piece; the last mean in unused rows.
    """
    out = np.full(positions.shape, np.nan + 0j)
    for n in range(positions.shape[1]):
        variance, last, piece = noise_ratio, -1, 0
        mean = 0j
        for k in range(len(times)):
            if pieces[k, n]:
                if pieces[k, n] != piece:
                    piece, variance = pieces[k, n], noise_ratio
                    mean = positions[k, n]
                else:
                    ahead = variance + 2.0 * (times[k] - times[last])
                    gain = ahead / (ahead + noise_ratio)
                    mean += gain * (positions[k, n] - mean)
                    variance = noise_ratio * gain
                last = k
            if last >= 0:
                out[k, n] = mean
    return out


@numba.njit(**_KEPT)
def _stationary_variance(diffusion_ratio, times, retention, k, n):  # type: ignore[no-untyped-def]
    """Return the variance of a heading that the field has held for long."""
    k = min(k, len(retention) - 1)
    q = min(retention[k, n], 0.999)
    if q <= 0:
        return 0.0
    return -diffusion_ratio * (times[k + 1] - times[k]) / math.log(q)


@numba.njit(**_KEPT)
def _heading_noise(h, diffusion_ratio, retention):  # type: ignore[no-untyped-def]
    """Return what noise of the heading adds in an interval h: an Ornstein–Uhlenbeck process.

    The velocity per sensitivity, the variance of its integral, their covariance, and the variance
    of the heading.
    """
    if retention < 1e-9:
        return 0.0, 0.0, 0.0, 0.0
    decay = -math.log(retention)
    if abs(decay) < 1e-3:
        variance = diffusion_ratio * 2 * h
        return 1 / h, variance * h**2 / 3, variance * h / 2, variance
    rate = decay / h
    spread = 2 / rate**2 * (h - 2 * (1 - retention) / rate + (1 - retention**2) / (2 * rate))
    return (rate / (1 - retention), diffusion_ratio * spread,
            diffusion_ratio * ((1 - retention) / rate) ** 2,
            diffusion_ratio * (1 - retention**2) / rate)


@numba.njit(**_KEPT)
def _heading_noises(times, diffusion_ratio, retention):  # type: ignore[no-untyped-def]
    """Return `_heading_noise` (T − 1, 4) of every frame interval, for the first particle."""
    out = np.empty((len(times) - 1, 4))
    for k in range(len(out)):
        out[k] = _heading_noise(times[k + 1] - times[k], diffusion_ratio, retention[k, 0])
    return out


NEGLIGIBLE = 1e-12
"""Covariance of x and y, relative to variances, that counts as 0. Choice: rounding errors."""


@numba.njit(forceinline=True, **_KEPT)
def _ahead(covariance, h, noise, wander, kick, stride, b, q):  # type: ignore[no-untyped-def]
    """Return the covariance of place and deviations an interval h later.

    `covariance` is (xx, xy, yy, xa, ya, aa, xb, yb, ab, bb): place (x, y), deviation a along the
    sensitivity `b`, and deviation b across it. `q` is the retention of both. `noise` of a is from
    `_heading_noise`; that of b is `wander` times as large. `kick` is the variance that moves the
    place besides; `stride` (complex) the standard deviation and direction of a step along the
    path.
    """
    xx, xy, yy, xa, ya, aa, xb, yb, ab, bb = covariance
    side, spread, mixed, turned = noise
    walk = 2 * h + kick
    if stride != 0:
        xx += stride.real * stride.real
        xy += stride.real * stride.imag
        yy += stride.imag * stride.imag
    if aa == 0 and turned == 0:  # the field holds the heading, as it mostly does
        return xx + walk, xy, yy + walk, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    u, v = b.real, b.imag
    i, j = u * side, v * side
    xx += 2 * u * xa + u * u * aa + spread * i * i + walk
    yy += 2 * v * ya + v * v * aa + spread * j * j + walk
    xy += u * ya + v * xa + u * v * aa + spread * i * j
    xa, ya = xa + u * aa, ya + v * aa
    if wander > 0:
        xx += 2 * v * (-xb - u * ab) + v * v * bb + wander * spread * j * j
        yy += 2 * u * (yb + v * ab) + u * u * bb + wander * spread * i * i
        xy += u * xb - v * yb + (u * u - v * v) * ab - u * v * bb - wander * spread * i * j
        xa, ya = xa - v * ab, ya + u * ab
        xb, yb = q * (xb + u * ab - v * bb), q * (yb + v * ab + u * bb)
        xb -= wander * mixed * j
        yb += wander * mixed * i
    return (xx, xy, yy, q * xa + mixed * i, q * ya + mixed * j, q * q * aa + turned,
            xb, yb, q * q * ab, q * q * bb + wander * turned)


@numba.njit(forceinline=True, **_KEPT)
def _seen(covariance, ratio_x, ratio_y, swing):  # type: ignore[no-untyped-def]
    """Return the covariance after a reading, with gains and the scale of the innovation.

    The gains are (xx, xy, yx, yy, ax, ay, bx, by). The innovation becomes white by (scale of x,
    lean, scale of y). The last value is the determinant of its covariance. A reading has the
    variances `ratio_x` and `ratio_y`, plus that of the complex `swing` in its direction.
    """
    xx, xy, yy, xa, ya, aa, xb, yb, ab, bb = covariance
    if swing != 0:
        mixed = swing.real * swing.imag
        ratio_x, ratio_y = ratio_x + swing.real * swing.real, ratio_y + swing.imag * swing.imag
    else:
        mixed = 0.0
    sx, sy, sxy = xx + ratio_x, yy + ratio_y, xy + mixed
    if aa == 0 and abs(sxy) < NEGLIGIBLE * sx:  # before it is a number too small to be fast
        gx, gy = xx / sx, yy / sy
        return ((ratio_x * gx, 0.0, ratio_y * gy, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                (gx, 0.0, 0.0, gy, 0.0, 0.0, 0.0, 0.0),
                (1 / math.sqrt(sx), 0.0, 1 / math.sqrt(sy)), sx * sy)
    det = sx * sy - sxy * sxy
    over = 1 / det
    gxx, gxy = (xx * sy - xy * sxy) * over, (xy * sx - xx * sxy) * over
    gyx, gyy = (xy * sy - yy * sxy) * over, (yy * sx - xy * sxy) * over
    gax, gay = (xa * sy - ya * sxy) * over, (ya * sx - xa * sxy) * over
    after = (gxx * ratio_x + gxy * mixed, gxx * mixed + gxy * ratio_y,
             gyx * mixed + gyy * ratio_y,
             xa - gxx * xa - gxy * ya, ya - gyx * xa - gyy * ya, aa - gax * xa - gay * ya)
    white = 1 / math.sqrt(sx), sxy / sx, math.sqrt(sx * over)
    if bb == 0:
        return ((*after, 0.0, 0.0, 0.0, 0.0), (gxx, gxy, gyx, gyy, gax, gay, 0.0, 0.0), white,
                det)
    gbx, gby = (xb * sy - yb * sxy) * over, (yb * sx - xb * sxy) * over
    across = (xb - gxx * xb - gxy * yb, yb - gyx * xb - gyy * yb,
              ab - gax * xb - gay * yb, bb - gbx * xb - gby * yb)
    return (*after, *across), (gxx, gxy, gyx, gyy, gax, gay, gbx, gby), white, det


@numba.njit(forceinline=True, **_KEPT)
def _begun(ratio_x, ratio_y, swing, turned, wander):  # type: ignore[no-untyped-def]
    """Return the covariance after the first reading of a piece.

    `turned` is the variance of deviation a; that of b is `wander` times as large.
    """
    return (ratio_x + swing.real * swing.real, swing.real * swing.imag,
            ratio_y + swing.imag * swing.imag, 0.0, 0.0, turned, 0.0, 0.0, 0.0, wander * turned)


@numba.njit(forceinline=True, **_KEPT)
def _carry(  # type: ignore[no-untyped-def]
        covariance, place, turn, k, n, times, noises, diffusion_ratio, sensitivity, retention,
        wander, kick, stride):
    """Return the covariance at row k of track n, an interval later.

    Changes `place` and `turn` (M,). The real part of `turn` is the deviation along the
    sensitivity, its imaginary part that across it.
    """
    b, q = sensitivity[k - 1, n], retention[k - 1, n]
    h = times[k] - times[k - 1]
    noise = (noises[k - 1, 0], noises[k - 1, 1], noises[k - 1, 2], noises[k - 1, 3])
    if q != retention[k - 1, 0]:
        noise = _heading_noise(h, diffusion_ratio, q)
    for m in range(len(place)):
        place[m] += b * turn[m]
        turn[m] *= q
    return _ahead(covariance, h, noise, wander, kick[k - 1, n], stride[k - 1, n], b, q)


@numba.njit(forceinline=True, **_KEPT)
def _taken(place, turn, m, new, gains):  # type: ignore[no-untyped-def]
    """Correct `place` and `turn` of column m by its `new` value; return the innovation."""
    gxx, gxy, gyx, gyy, gax, gay, gbx, gby = gains
    step = new - place[m]
    i, j = step.real, step.imag
    place[m] += complex(gxx * i + gxy * j, gyx * i + gyy * j)
    turn[m] += complex(gax * i + gay * j, gbx * i + gby * j)
    return i, j


@numba.njit(forceinline=True, **_KEPT)
def _logged(log_det, product):  # type: ignore[no-untyped-def]
    """Return ½ log det so far, and the `product` of determinants that it lacks.

    One logarithm for many, since it costs as much as all the rest.
    """
    if 1e-150 < product < 1e150:
        return log_det, product
    return log_det + 0.5 * math.log(product), 1.0


@numba.njit(f'({_ROWS}, {_COLUMNS}, float64, float64, float64, {_TURNS}, {_RETENTION}, {_TURNS}, '
            f'float64, {_RETENTION}, {_TURNS})', **_KEPT)
def whiten_with_heading(  # type: ignore[no-untyped-def]
        times, pieces, columns, ratio_x, ratio_y, diffusion_ratio, sensitivity, retention,
        swing, wander, kick, stride):
    """Whiten columns where headings have noise as well.

    A Kalman filter of place (x, y) and two deviations (a, b), whose covariance is kept as ten
    scalars.

    Parameters
    ----------
    times, pieces
        As for `whiten_columns`.
    columns : ndarray of complex, shape (T, N, M)
        Positions or displacements [m].
    ratio_x, ratio_y : float
        Noise ratio of either axis [s].
    diffusion_ratio : float
        D_r/D [rad²/m²].
    sensitivity : ndarray of complex, shape (T − 1, N)
        Displacement in an interval per radian at its start [m/rad].
    retention : ndarray, shape (T − 1, N)
        Fraction of a deviation that remains at the end of an interval.
    swing : ndarray of complex, shape (T, N)
        Standard deviation and direction of additional scatter of readings [√s].
    wander : float
        Variance of the deviation across the sensitivity over that along it.
    kick : ndarray, shape (T − 1, N)
        Variance that an interval adds to either axis besides 2h, in units of D [s].
    stride : ndarray of complex, shape (T − 1, N)
        Standard deviation and direction of what an interval adds along the path [√s].

    Returns
    -------
    out : ndarray of complex, shape (T, N, M)
        Increments whose real and imaginary parts are independent, of unit variance.
    log_det : float
        ½ log det of the innovations over both axes.
    used : int
        Rows used.
    factors : ndarray, shape (T, N, 4)
        Elements xx, yx and yy of the triangular matrices by which innovations become white, and
        the deviation along the sensitivity of the first column; 0 in unused rows.
    """
    T, N, M = columns.shape
    out, factors = np.zeros((T, N, M), np.complex128), np.zeros((T, N, 4))
    log_det, used, product = 0.0, 0, 1.0
    noises = _heading_noises(times, diffusion_ratio, retention)
    place, turn = np.zeros(M, np.complex128), np.zeros(M, np.complex128)
    for n in range(N):
        piece = 0
        covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for k in range(T):
            if piece:
                covariance = _carry(covariance, place, turn, k, n, times, noises,
                                    diffusion_ratio, sensitivity, retention, wander, kick, stride)
            if not pieces[k, n]:
                continue
            if pieces[k, n] != piece:
                piece = pieces[k, n]
                covariance = _begun(ratio_x, ratio_y, swing[k, n], _stationary_variance(
                    diffusion_ratio, times, retention, k, n), wander)
                for m in range(M):
                    place[m], turn[m] = columns[k, n, m], 0j
                continue
            covariance, gains, white, det = _seen(covariance, ratio_x, ratio_y, swing[k, n])
            scale_x, lean, scale_y = white
            log_det, product = _logged(log_det, product * det)
            used += 1
            for m in range(M):
                i, j = _taken(place, turn, m, columns[k, n, m], gains)
                out[k, n, m] = complex(i * scale_x, (j - lean * i) * scale_y)
            factors[k, n, 0], factors[k, n, 1] = scale_x, -lean * scale_y
            factors[k, n, 2], factors[k, n, 3] = scale_y, turn[0].real
    return out, log_det + 0.5 * math.log(product), used, factors


@numba.njit(**_KEPT)
def whitened_products_with_heading(  # type: ignore[no-untyped-def]
        times, pieces, z, offset, along, noise_ratio, diffusion_ratio, sensitivity, retention,
        swing, wander, kick, stride):
    """Return inner products as `whitened_products` where headings have noise as well.

    Parameters
    ----------
    times, pieces, z, offset, along, noise_ratio
        As for `whitened_products`.
    diffusion_ratio, sensitivity, retention, swing, wander, kick, stride
        As for `whiten_with_heading`.

    Returns
    -------
    products : ndarray, shape (N, 3, 3)
        Real inner products of `z` − `offset`, `along` and i·`along`.
    log_det : float
        ½ log det over both axes.
    used : int
        Rows used.
    """
    T, N = z.shape
    products, log_det, used, product = np.zeros((N, 3, 3)), 0.0, 0, 1.0
    noises = _heading_noises(times, diffusion_ratio, retention)
    place, turn = np.zeros(3, np.complex128), np.zeros(3, np.complex128)
    new, white_new = np.zeros(3, np.complex128), np.zeros(3, np.complex128)
    for n in range(N):
        o, a = min(n, offset.shape[1] - 1), min(n, along.shape[1] - 1)
        gram, piece = products[n], 0
        covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for k in range(T):
            if piece:
                covariance = _carry(covariance, place, turn, k, n, times, noises,
                                    diffusion_ratio, sensitivity, retention, wander, kick, stride)
            if not pieces[k, n]:
                continue
            new[0], new[1], new[2] = z[k, n] - offset[k, o], along[k, a], 1j * along[k, a]
            if pieces[k, n] != piece:
                piece = pieces[k, n]
                covariance = _begun(noise_ratio, noise_ratio, swing[k, n], _stationary_variance(
                    diffusion_ratio, times, retention, k, n), wander)
                for m in range(3):
                    place[m], turn[m] = new[m], 0j
                continue
            covariance, gains, white, det = _seen(
                covariance, noise_ratio, noise_ratio, swing[k, n])
            scale_x, lean, scale_y = white
            log_det, product = _logged(log_det, product * det)
            used += 1
            for m in range(3):
                i, j = _taken(place, turn, m, new[m], gains)
                x, y = i * scale_x, (j - lean * i) * scale_y
                white_new[m] = complex(x, y)
                for other in range(m + 1):
                    gram[m, other] += x * white_new[other].real + y * white_new[other].imag
        for m in range(3):
            for other in range(m):
                gram[other, m] = gram[m, other]
    return products, log_det + 0.5 * math.log(product), used
