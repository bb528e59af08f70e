"""Field and gradient of a circular current loop, exact to rounding from the wire to infinity.

The loop has radius a, lies in the plane z = 0 about the origin and carries 1 A, counterclockwise
seen from +z. With D² = a² + ρ² + z² − 2aρ cos φ, the Biot–Savart law B = µ₀/4π ∮ dl × r̂/r² needs
four integrals over φ: of 1/Dⁿ and cos φ/Dⁿ, n = 3 and 5. With

    α² = (a − ρ)² + z²,  β² = (a + ρ)² + z²,  u = 4aρ/β²,  q = α²/β² = 1 − u

and the arithmetic–geometric mean of 1 and √q and its differences cₙ (DLMF 19.8(i)) they are

    ∮ 1/D³ = 4E/(βα²),       E = K (1 − u/2 − u² t),  K = π/(2 agm),  t = Σₙ≥₁ 2ⁿ⁻¹ (cₙ/u)²,
    ∮ cos φ/D³ = 4uG/(βα²),  G = K (1/2 − (2 − u) t),
    ∮ 1/D⁵ = 4P/(βα⁴),       P = (2 (1 + q) E − q K)/3,
    ∮ cos φ/D⁵ = 4uH/(βα⁴),  H = K (2 − u − 2 (1 − u + u²) t)/3.

The textbook forms with E − K lose digits at the axis and far away, where the leading terms cancel.
Here these terms are cancelled analytically, so that u → 0 is a regular point. Near the wire,
q → 0, the difference ∮ (a − ρ cos φ)/Dⁿ cancels; there it is computed from

    aE − ρuG = (a − ρ) E + 2ρq K (1/2 + u t),
    aP − ρuH = (a − ρ) P + 2ρq ((1 − 2q) E + q K)/(3u).
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.units import MU_0

ON_WIRE = 1e-12
"""Choice: a point within this part of the radius from the wire counts as on it (field NaN)."""

# Points are processed in blocks, so that their elliptic integrals are vectorised; the quantities
# of a block are the rows of one array. Choice: 11 rows of 128 doubles fit into the L1 cache.
_BLOCK = 128
_X, _Y, _Z, _RHO, _ALPHA2, _BETA2, _U, _MEAN, _SCALED, _DIFFERENCE, _T = range(11)

# Choice: below this q the forms for points near the wire are used. Both are identities; this
# decides which of them loses fewer digits.
_BESIDE = 0.1

_compiled = numba.njit(cache=True, error_model='numpy', fastmath={'contract'})


@_compiled
def _locate(points: np.ndarray, centre: np.ndarray, axes: np.ndarray, a: float,
            block: np.ndarray) -> None:
    """Write the coordinates of the points in the frame of the loop, and α², β² and u."""
    on_wire = (ON_WIRE * a) ** 2
    for i in range(len(points)):
        dx, dy, dz = (points[i, 0] - centre[0], points[i, 1] - centre[1],
                      points[i, 2] - centre[2])
        x = axes[0, 0] * dx + axes[1, 0] * dy + axes[2, 0] * dz
        y = axes[0, 1] * dx + axes[1, 1] * dy + axes[2, 1] * dz
        z = axes[0, 2] * dx + axes[1, 2] * dy + axes[2, 2] * dz
        rho = math.sqrt(x * x + y * y)
        alpha2 = (a - rho) ** 2 + z * z
        beta2 = (a + rho) ** 2 + z * z
        block[_X, i], block[_Y, i], block[_Z, i], block[_RHO, i] = x, y, z, rho
        block[_ALPHA2, i] = alpha2 if alpha2 > on_wire else math.nan
        block[_BETA2, i] = beta2
        block[_U, i] = 4 * a * rho / beta2


@_compiled
def _integrate(n: int, block: np.ndarray) -> None:
    """Write the arithmetic–geometric mean and t of the first n points of a block.

    cₙ converges quadratically: once it is below 1e-8 at the slowest point, all further terms are
    rounding.
    """
    mean, scaled, difference, t = block[_MEAN], block[_SCALED], block[_DIFFERENCE], block[_T]
    for i in range(n):
        geometric = math.sqrt(block[_ALPHA2, i] / block[_BETA2, i])
        mean[i] = 0.5 * (1 + geometric)
        scaled[i] = 0.5 / (1 + geometric)
        difference[i] = scaled[i] * block[_U, i]
        t[i] = scaled[i] * scaled[i]
    weight = 1.0
    while difference[:n].max() > 1e-8:
        weight *= 2
        for i in range(n):
            geometric = math.sqrt((mean[i] - difference[i]) * (mean[i] + difference[i]))
            mean[i] = 0.5 * (mean[i] + geometric)
            factor = difference[i] / (4 * mean[i])
            scaled[i] *= factor
            difference[i] *= factor
            t[i] += weight * scaled[i] * scaled[i]


@_compiled
def loop_field(points: np.ndarray, centre: np.ndarray, axes: np.ndarray, a: float, turns: float,
               out: np.ndarray) -> None:
    """Write the field per ampere [T/A] of a loop to `out`; NaN on the wire.

    Parameters
    ----------
    points : (M, 3) array [m]
        Points at which the field is computed.
    centre : (3,) array [m]
        Centre of the loop.
    axes : (3, 3) array
        The x, y and z axes of the loop as columns.
    a : float
        Radius [m].
    turns : float
        Factor of the field.
    out : (M, 3) array
        Receives the field per ampere [T/A].
    """
    block = np.empty((11, _BLOCK))
    for start in range(0, len(points), _BLOCK):
        here = points[start:start + _BLOCK]
        _locate(here, centre, axes, a, block)
        _integrate(len(here), block)
        for i in range(len(here)):
            u, t, rho, beta2 = block[_U, i], block[_T, i], block[_RHO, i], block[_BETA2, i]
            q, K = block[_ALPHA2, i] / beta2, 0.5 * math.pi / block[_MEAN, i]
            E = K * (1 - u * (0.5 + u * t))
            G = K * (0.5 - (2 - u) * t)
            beside = (a - rho) * E + 2 * rho * q * K * (0.5 + u * t)
            common = turns * MU_0 / math.pi * a / (math.sqrt(beta2) * block[_ALPHA2, i])
            radial = common * G * 4 * a / beta2 * block[_Z, i]
            bx, by = radial * block[_X, i], radial * block[_Y, i]
            bz = common * (beside if q < _BESIDE else a * E - rho * u * G)
            for j in range(3):
                out[start + i, j] = axes[j, 0] * bx + axes[j, 1] * by + axes[j, 2] * bz


@_compiled
def loop_gradient(points: np.ndarray, centre: np.ndarray, axes: np.ndarray, a: float,
                  turns: float, out: np.ndarray) -> None:
    """Write the gradient per ampere ∂Bᵢ/∂xⱼ [T/m/A] of a loop to `out` (M, 3, 3).

    `points`, `centre`, `axes`, `a` and `turns` as in `loop_field`. The gradient is symmetric and
    has no trace, since the field has neither curl nor divergence off the wire.

    Parameters
    ----------
    points : ndarray, shape (M, 3)
        Points [m].
    centre : ndarray, shape (3,)
        Centre of the loop [m].
    axes : ndarray, shape (3, 3)
        Axes of the loop, as in `loop_field`.
    a : float
        Radius of the loop [m].
    turns : float
        Number of turns.
    out : ndarray, shape (M, 3, 3)
        Array that receives the gradient.
    """
    block = np.empty((11, _BLOCK))
    local = np.empty((3, 3))
    for start in range(0, len(points), _BLOCK):
        here = points[start:start + _BLOCK]
        _locate(here, centre, axes, a, block)
        _integrate(len(here), block)
        for i in range(len(here)):
            _local_gradient(block[:, i], a, turns, local)
            out[start + i] = axes @ local @ axes.T


@_compiled
def _local_gradient(point: np.ndarray, a: float, turns: float, out: np.ndarray) -> None:
    """Write the gradient at one point of a block, in the frame of the loop."""
    alpha2, beta2, u, t, z = point[_ALPHA2], point[_BETA2], point[_U], point[_T], point[_Z]
    K, q = 0.5 * math.pi / point[_MEAN], alpha2 / beta2
    E = K * (1 - u * (0.5 + u * t))
    G = K * (0.5 - (2 - u) * t)
    P = (2 * (1 + q) * E - q * K) / 3
    H = K * (2 - u - 2 * (1 - u + u * u) * t) / 3
    common = turns * MU_0 / math.pi * a / (math.sqrt(beta2) * alpha2)
    # Bρ/ρ, ∂Bz/∂z, ∂Bz/∂ρ = ∂Bρ/∂z, and ∂Bρ/∂ρ − Bρ/ρ from the zero divergence.
    hoop = common * G * 4 * a * z / beta2
    along = a * P - point[_RHO] * u * H
    if q < _BESIDE:
        along = (a - point[_RHO]) * P + 2 * point[_RHO] * q * ((1 - 2 * q) * E + q * K) / (3 * u)
    axial = -3 * common * z * along / alpha2
    shear = common * u * (G - 3 * z * z * H / alpha2)
    excess = -(2 * hoop + axial)
    # On the axis shear and excess vanish, whatever direction ρ is given.
    cosine, sine = (point[_X] / point[_RHO], point[_Y] / point[_RHO]) if point[_RHO] else (1., 0.)
    out[0, 0] = hoop + excess * cosine * cosine
    out[1, 1] = hoop + excess * sine * sine
    out[2, 2] = axial
    out[0, 1] = out[1, 0] = excess * cosine * sine
    out[0, 2] = out[2, 0] = shear * cosine
    out[1, 2] = out[2, 1] = shear * sine
