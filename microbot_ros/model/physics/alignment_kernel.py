"""Exact solution of dχ/dt = κ sin(ψ − χ), and of χ = ψ, compiled."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from microbot_ros.common.compiled import numba

UNSTABLE = 0.01
"""Angle [rad] from exact opposition to the field within which a heading is moved away from it.

The equation stays in exact opposition for ever, which no Brownian particle does. Choice: within
this angle noise decides, not the equation.
"""


def given(dtype: str, dimensions: int, layout: Literal['A', 'C'] = 'A') -> str:
    """Return the numba type of arrays that a compiled function only reads.

    Arrays that may be written to would otherwise be compiled anew.

    Parameters
    ----------
    dtype : str
        Numba's name of the type of the elements.
    dimensions : int
        Number of dimensions.
    layout : 'A' or 'C', optional
        Any layout, or contiguous.

    Returns
    -------
    str
        The type, as in signatures.
    """
    return f'Array({dtype}, {dimensions}, {layout!r}, readonly=True)'


@numba.njit(cache=True, error_model='numpy')
def integrate_direction(rows, delay, times, heading, rolling):  # type: ignore[no-untyped-def]
    """Integrate the direction of the field, for headings that follow it immediately.

    Without effects. The direction u is that of the field, or the last one where there is no field.

    Parameters
    ----------
    rows : ndarray, shape (K, 4)
        Commands: time [s], field [T] and frequency [Hz].
    delay : float
        Delay of the commands [s].
    times : ndarray, shape (T,)
        Times of the frames [s].
    heading : complex
        e^{iχ} at the first time; 0 if the earlier commands determine it.
    rolling : bool
        Whether to weight by frequency.

    Returns
    -------
    path : ndarray of complex, shape (T − 1,)
        ∫u dt [s] over the frame intervals, or ∫f u dt.
    course : ndarray of complex, shape (T,)
        e^{iχ} at the frames.
    """
    count, u, acting = len(rows), heading, -1
    path, course = np.zeros(len(times) - 1, np.complex128), np.zeros(len(times), np.complex128)
    k = np.searchsorted(rows[:, 0], times[0] - delay, side='right') - 1
    last = k
    while last >= 0 and u == 0:
        # A command that was replaced at the same time never acted.
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
    """Return the direction of a command's field; without a field, the direction before."""
    size = math.hypot(row[1], row[2])
    return complex(row[1] / size, row[2] / size) if size > 0 else before


@numba.njit(cache=True)
def _span(relative, rate, h):  # type: ignore[no-untyped-def]
    """Return ∫cos δ, ∫sin δ, their derivatives by δ₀, cos δ₁, sin δ₁ and ∂δ₁/∂δ₀ of a span."""
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


@numba.njit(f'({given("complex128", 1)}, {given("complex128", 2)}, '
            f'{given("float64", 2)}, {given("float64", 1)})', cache=True)
def integrate_alignment(start, target, rate, span):  # type: ignore[no-untyped-def]
    """Solve dχ/dt = κ sin(ψ − χ) through S spans of constant ψ and κ, n headings at once.

    With δ = χ − ψ the solution is tan(δ(s)/2) = tan(δ₀/2) e^{−κs}, hence ∫cos δ = h + ln(cos²½δ₀ +
    q² sin²½δ₀)/κ and ∫sin δ = (δ₀ − δ₁)/κ with q = e^{−κh}.

    Parameters
    ----------
    start : ndarray of complex, shape (n,)
        e^{iχ} at the start; 0 where the heading is not defined yet. It is then that of the first
        target that is not zero.
    target : ndarray of complex, shape (S, n)
        e^{iψ}; 0 without a field.
    rate : ndarray, shape (S, n)
        κ [1/s].
    span : ndarray, shape (S,)
        h [s].

    Returns
    -------
    heading : ndarray of complex, shape (S + 1, n)
        e^{iχ} at the edges.
    path : ndarray of complex, shape (S, n)
        ∫e^{iχ} ds [s].
    sensitivity : ndarray of complex, shape (S, n)
        Derivative of the path by χ at the start of the span [s].
    retention : ndarray, shape (S, n)
        Derivative of χ at the end of the span by χ at its start.
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


@numba.njit(f'({given("int64", 1)}, {given("complex128", 2)}, {given("float64", 2)})', cache=True)
def chain_intervals(first, sensitivity, retention):  # type: ignore[no-untyped-def]
    """Return derivatives over whole frame intervals from those over their spans.

    Parameters
    ----------
    first : ndarray of int, shape (F,)
        First span of each interval.
    sensitivity : ndarray of complex, shape (S, n)
        As returned by `integrate_alignment` [s].
    retention : ndarray, shape (S, n)
        As returned by `integrate_alignment`.

    Returns
    -------
    sensitivities : ndarray of complex, shape (F, n)
        Derivative of each interval's path by the heading at its start [s].
    retentions : ndarray, shape (F, n)
        Derivative of the heading at its end by that at its start.
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
