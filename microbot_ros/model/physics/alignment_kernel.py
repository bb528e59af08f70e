"""The exact solution of dχ/dt = κ sin(ψ − χ), and of χ = ψ, compiled."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numba import types

from microbot_ros.common.compiled import numba

UNSTABLE = 0.01
"""A heading this close [rad] to opposing the field is moved this far from it.

Exactly opposed, the equation stays there for ever, which no particle that is kicked by water
does; within this angle noise decides, not the equation.
"""


def given(dtype: types.Type, dimensions: int, layout: Literal['A', 'C'] = 'A') -> types.Array:
    """Arrays of so many `dimensions` and a `dtype` that a compiled function reads.

    Their `layout` is any, 'A', or contiguous, 'C'. One that may be written to would otherwise be
    compiled anew.
    """
    return types.Array(dtype, dimensions, layout, readonly=True)


@numba.njit(cache=True, error_model='numpy')
def integrate_direction(rows, delay, times, heading, rolling):  # type: ignore[no-untyped-def]
    """∫u dt [s] over T−1 frame intervals, ∫f u dt if `rolling`, and e^{iχ} at `times` (T,) [s].

    For headings that follow the field at once, where no effect acts: u is its direction, or the
    last before where there is none. `rows` (K, 4) are the commands: time [s], field [T] and
    frequency [Hz], `delay` [s] late. `heading` is e^{iχ} at the first time, 0 where the commands
    before decide.
    """
    count, u, acting = len(rows), heading, -1
    path, course = np.zeros(len(times) - 1, np.complex128), np.zeros(len(times), np.complex128)
    k = np.searchsorted(rows[:, 0], times[0] - delay, side='right') - 1
    last = k
    while last >= 0 and u == 0:
        # A command that another replaced at once never acted.
        if last == k or rows[last + 1, 0] > rows[last, 0]:
            u = _along(rows[last], u)
        last -= 1
    for frame in range(len(path)):
        now, end = times[frame], times[frame + 1]
        while True:
            until = min(rows[k + 1, 0] + delay, end) if k + 1 < count else end
            if until > now:
                if k != acting:
                    u, acting = _along(rows[k], u), k
                if now == times[frame]:
                    course[frame] = u
                path[frame] += u * (until - now) * (
                    (rows[k, 3] if k >= 0 else 0.0) if rolling else 1.0)
                now = until
            if not until < end:
                break
            k += 1
    course[-1] = u
    return path, course


@numba.njit(cache=True)
def _along(row, before):  # type: ignore[no-untyped-def]
    """The direction of a command's field; without one, that of before."""
    size = math.hypot(row[1], row[2])
    return complex(row[1] / size, row[2] / size) if size > 0 else before


@numba.njit(cache=True)
def _span(relative, rate, h):  # type: ignore[no-untyped-def]
    """∫cos δ, ∫sin δ, their derivatives to δ₀, cos δ₁, sin δ₁ and ∂δ₁/∂δ₀ over one span."""
    cos0, sin0 = relative.real, relative.imag
    if cos0 < -math.cos(UNSTABLE):
        cos0, sin0 = -math.cos(UNSTABLE), math.copysign(math.sin(UNSTABLE), sin0)
    q = math.exp(-rate * h)
    near, far = (1 + cos0) / 2, (1 - cos0) / 2
    scale = near + far * q * q
    retention = q / scale
    cos1, sin1 = (near - far * q * q) / scale, retention * sin0
    if rate * h < 1e-100:
        C, Sn, dC, dS = h * cos0, h * sin0, -h * sin0, h * cos0
    else:
        turned, lost = -math.expm1(-rate * h), math.expm1(-2 * rate * h)
        C = h + math.log1p(far * lost) / rate
        Sn = 2 * math.atan2(sin0 * turned / 2, near + far * q) / rate
        dC, dS = sin0 * lost / (2 * rate * scale), turned * (near - far * q) / (rate * scale)
    return C, Sn, dC, dS, cos1, sin1, retention


@numba.njit([(given(types.complex128, 1), given(types.complex128, 2),
             given(types.float64, 2), given(types.float64, 1))], cache=True)
def integrate_alignment(start, target, rate, span):  # type: ignore[no-untyped-def]
    """Solve dχ/dt = κ sin(ψ − χ) through S spans of constant ψ and κ, n headings at once.

    `start` (n,) complex, zero where the heading is not defined yet: it is then that of the first
    target which is not zero. `target` (S, n) e^{iψ}, zero where there is no field; `rate` κ (S, n)
    [1/s]; `span` h (S,) [s].

    With δ = χ − ψ the solution is tan(δ(s)/2) = tan(δ₀/2) e^{−κs}, hence ∫cos δ = h + ln(cos²½δ₀ +
    q² sin²½δ₀)/κ and ∫sin δ = (δ₀ − δ₁)/κ with q = e^{−κh}. Returns, each (S, n) but the first:
    e^{iχ} at every edge (S + 1, n); ∫e^{iχ} ds; its derivative with respect to χ at the start of
    the span; and the derivative of χ at its end with respect to that at its start.
    """
    S, n = target.shape
    heading = np.zeros((S + 1, n), np.complex128)
    path = np.zeros((S, n), np.complex128)
    sensitivity = np.zeros((S, n), np.complex128)
    retention = np.zeros((S, n))
    for i in range(n):
        w = start[i]
        for k in range(S):
            u = target[k, i]
            if w == 0:
                w = u
            if w == 0:
                continue
            heading[k, i] = w
            if u == 0:
                u = w
            C, Sn, dC, dS, cos1, sin1, retention[k, i] = _span(
                w * u.conjugate(), rate[k, i], span[k])
            path[k, i] = u * complex(C, Sn)
            sensitivity[k, i] = u * complex(dC, dS)
            w = u * complex(cos1, sin1)
            w /= abs(w)
        heading[S, i] = w
    return heading, path, sensitivity, retention


@numba.njit([(given(types.int64, 1), given(types.complex128, 2), given(types.float64, 2))],
            cache=True)
def chain_intervals(first, sensitivity, retention):  # type: ignore[no-untyped-def]
    """Derivatives over whole frame intervals from those over their spans.

    `first` (F,): the span with which each interval begins; `sensitivity` (S, n) complex [s] and
    `retention` (S, n) as `integrate_alignment` returns them. Returns the derivative of each
    interval's path [s] and of the heading at its end, both with respect to the heading at its
    start: (F, n) complex and (F, n).
    """
    S, n = retention.shape
    F = len(first)
    sensitivities, retentions = np.zeros((F, n), np.complex128), np.ones((F, n))
    for f in range(F):
        for k in range(first[f], first[f + 1] if f + 1 < F else S):
            for i in range(n):
                sensitivities[f, i] += retentions[f, i] * sensitivity[k, i]
                retentions[f, i] *= retention[k, i]
    return sensitivities, retentions
