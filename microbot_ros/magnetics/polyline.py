"""Field and gradient of straight current-carrying segments.

For a segment from p₁ to p₂, with rᵢ the vectors from its ends to the point, the Biot–Savart law
integrates to (Hanson and Hirshman, Physics of Plasmas 9, 4410 (2002))

    B = µ₀I/4π · (p₂ − p₁) × r₁ · F,   F = (r₁ + r₂)/(r₁ r₂ S),   S = r₁ r₂ + r₁·r₂
    ∇F/F = (r̂₁ + r̂₂) (1/(r₁ + r₂) − (r₁ + r₂)/S) − r̂₁/r₁ − r̂₂/r₂.

Beside the segment S is a small difference of large numbers; |r₁ × r₂|²/(r₁ r₂ − r₁·r₂) is equal
and loses no digits. An open polyline is not a complete circuit: its field has curl everywhere and
its gradient is not symmetric. Close it by repeating the first vertex at the end.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.units import MU_0

ON_WIRE = 1e-12
"""Choice: a point within this part of a segment's length from it counts as on it (field NaN)."""

_compiled = numba.njit(cache=True, error_model='numpy', fastmath={'contract'})


@_compiled
def _segment(start: np.ndarray, end: np.ndarray, point: np.ndarray,
             work: np.ndarray) -> tuple[float, float, float, float]:
    """Write r₁, r₂ and (p₂ − p₁) × r₁ to the rows of work; return |r₁|, |r₂|, S and F."""
    length2 = dot = square1 = square2 = 0.0
    for j in range(3):
        r1, r2, along = point[j] - start[j], point[j] - end[j], end[j] - start[j]
        work[0, j], work[1, j] = r1, r2
        length2 += along * along
        dot += r1 * r2
        square1 += r1 * r1
        square2 += r2 * r2
    cross2 = 0.0
    for j in range(3):
        m, n = (j + 1) % 3, (j + 2) % 3
        work[2, j] = (end[m] - start[m]) * work[0, n] - (end[n] - start[n]) * work[0, m]
        cross2 += work[2, j] * work[2, j]
    r1, r2 = math.sqrt(square1), math.sqrt(square2)
    if cross2 <= (ON_WIRE * length2) ** 2 and dot <= ON_WIRE ** 2 * length2:
        return r1, r2, math.nan, math.nan
    S = r1 * r2 + dot if dot >= 0 else cross2 / (r1 * r2 - dot)
    return r1, r2, S, (r1 + r2) / (r1 * r2 * S)


@_compiled
def polyline_field(points: np.ndarray, vertices: np.ndarray, turns: float,
                   out: np.ndarray) -> None:
    """Write the field per ampere [T/A] of a polyline at `points` (M, 3) [m] to `out` (M, 3).

    The current runs along `vertices` (V, 3) [m] in their order, `turns` times. NaN on the wire.

    Parameters
    ----------
    points : ndarray, shape (M, 3)
        Points [m].
    vertices : ndarray, shape (V, 3)
        Vertices in order [m].
    turns : float
        Number of turns.
    out : ndarray, shape (M, 3)
        Array that receives the field.
    """
    work = np.empty((3, 3))
    for i in range(len(points)):
        out[i] = 0
        for k in range(len(vertices) - 1):
            _, _, _, F = _segment(vertices[k], vertices[k + 1], points[i], work)
            out[i] += turns * MU_0 / (4 * math.pi) * F * work[2]


@_compiled
def polyline_gradient(points: np.ndarray, vertices: np.ndarray, turns: float,
                      out: np.ndarray) -> None:
    """Write the gradient per ampere ∂Bᵢ/∂xⱼ [T/m/A] at `points` (M, 3) [m] to `out` (M, 3, 3).

    `vertices` and `turns` as in `polyline_field`.

    Parameters
    ----------
    points : ndarray, shape (M, 3)
        Points [m].
    vertices : ndarray, shape (V, 3)
        Vertices in order [m].
    turns : float
        Number of turns.
    out : ndarray, shape (M, 3, 3)
        Array that receives the gradient.
    """
    work = np.empty((3, 3))
    for i in range(len(points)):
        out[i] = 0
        for k in range(len(vertices) - 1):
            r1, r2, S, F = _segment(vertices[k], vertices[k + 1], points[i], work)
            scale = turns * MU_0 / (4 * math.pi) * F
            for j in range(3):
                u1, u2 = work[0, j] / r1, work[1, j] / r2
                slope = (u1 + u2) * (1 / (r1 + r2) - (r1 + r2) / S) - u1 / r1 - u2 / r2
                for m in range(3):
                    out[i, m, j] += scale * work[2, m] * slope
            # ∂((p₂ − p₁) × r₁)ᵢ/∂xⱼ is the cross-product matrix of p₂ − p₁.
            x, y, z = scale * (vertices[k + 1] - vertices[k])
            out[i, 0, 1] -= z
            out[i, 1, 0] += z
            out[i, 0, 2] += y
            out[i, 2, 0] -= y
            out[i, 1, 2] -= x
            out[i, 2, 1] += x
