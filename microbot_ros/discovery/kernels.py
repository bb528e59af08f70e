"""Whitening of tracks whose heading jitters: the inner loop, compiled. Imported when needed."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def filter_levels(times, seen, levels, excess):  # type: ignore[no-untyped-def]
    """What the local-level filter believes of `levels` (T, N) complex after every frame.

    Rows before a particle is first seen are NaN; unseen ones keep the last belief.
    """
    out = np.full(levels.shape, np.nan + 0j)
    for n in range(levels.shape[1]):
        variance, last = excess, -1
        belief = 0j
        for k in range(len(times)):
            if seen[k, n]:
                if last < 0:
                    belief = levels[k, n]
                else:
                    ahead = variance + 2.0 * (times[k] - times[last])
                    gain = ahead / (ahead + excess)
                    belief += gain * (levels[k, n] - belief)
                    variance = excess * gain
                last = k
            if last >= 0:
                out[k, n] = belief
    return out


@njit(cache=True)
def whiten_turning(times, seen, levels, excess, turning, bend, kept):  # type: ignore[no-untyped-def]
    """Whitened increments of complex `levels` (T, N, M) of particles that also jitter in heading.

    For D = 1: `excess` as in `whiten_levels`, `turning` = D_r/D [rad²/m²], `bend` (T−1, N)
    complex: displacement over a frame interval per radian at its start, `kept` (T−1, N): the part
    of a turn left at its end. A Kalman filter over place (x, y) and turn (a), whose covariance is
    kept as six scalars; real and imaginary parts of the result are independent. Returns columns,
    ½ log det of the innovations over both axes, rows used.
    """
    T, N, M = levels.shape
    out = np.zeros((T, N, M), np.complex128)
    log_det, used = 0.0, 0
    place, turn = np.zeros(M, np.complex128), np.zeros(M)
    for n in range(N):
        started = False
        xx = xy = yy = xa = ya = aa = 0.0
        for k in range(T):
            if started:
                b, q = bend[k - 1, n], kept[k - 1, n]
                h = times[k] - times[k - 1]
                side, spread, mixed, turned = _jitter(h, turning, b, q)
                u, v = b.real, b.imag
                xx += 2 * u * xa + u * u * aa + spread * side.real**2 + 2 * h
                yy += 2 * v * ya + v * v * aa + spread * side.imag**2 + 2 * h
                xy += u * ya + v * xa + u * v * aa + spread * side.real * side.imag
                xa = q * (xa + u * aa) + mixed * side.real
                ya = q * (ya + v * aa) + mixed * side.imag
                aa = q * q * aa + turned
                for m in range(M):
                    place[m] += b * turn[m]
                    turn[m] *= q
            if not seen[k, n]:
                continue
            if not started:
                started = True
                xx = yy = excess
                xy = xa = ya = 0.0
                aa = _settled(turning, times, kept, k, n)
                place[:] = levels[k, n]
                turn[:] = 0.0
                continue
            sx, sy = xx + excess, yy + excess
            det = sx * sy - xy * xy
            scale_x, lean = 1 / math.sqrt(sx), xy / sx
            scale_y = math.sqrt(sx / det)
            log_det += 0.5 * math.log(det)
            used += 1
            gxx, gxy = (xx * sy - xy * xy) / det, (xy * sx - xx * xy) / det
            gyx, gyy = (xy * sy - yy * xy) / det, (yy * sx - xy * xy) / det
            gax, gay = (xa * sy - ya * xy) / det, (ya * sx - xa * xy) / det
            for m in range(M):
                step = levels[k, n, m] - place[m]
                i, j = step.real, step.imag
                out[k, n, m] = complex(i * scale_x, (j - lean * i) * scale_y)
                place[m] += complex(gxx * i + gxy * j, gyx * i + gyy * j)
                turn[m] += gax * i + gay * j
            aa -= gax * xa + gay * ya
            xa, ya = xa - gxx * xa - gxy * ya, ya - gyx * xa - gyy * ya
            xx, xy, yy = excess * gxx, excess * gxy, excess * gyy
    return out, log_det, used


@njit(cache=True)
def _settled(turning, times, kept, k, n):  # type: ignore[no-untyped-def]
    """Variance of a heading that the field has long held."""
    k = min(k, len(kept) - 1)
    q = min(kept[k, n], 0.999)
    if q <= 0:
        return 0.0
    return -turning * (times[k + 1] - times[k]) / math.log(q)


@njit(cache=True)
def _jitter(h, turning, bend, kept):  # type: ignore[no-untyped-def]
    """What noise in the heading adds over an interval h: an Ornstein–Uhlenbeck process.

    The velocity per radian, and the variance of its integral, their covariance, the variance of
    the heading.
    """
    if kept < 1e-9:
        return 0j, 0.0, 0.0, 0.0
    decay = -math.log(kept)
    if abs(decay) < 1e-3:
        return bend / h, turning * h**3 * 2 / 3, turning * h**2, turning * 2 * h
    rate = decay / h
    spread = 2 / rate**2 * (h - 2 * (1 - kept) / rate + (1 - kept**2) / (2 * rate))
    return (bend * rate / (1 - kept), turning * spread, turning * ((1 - kept) / rate) ** 2,
            turning * (1 - kept**2) / rate)
