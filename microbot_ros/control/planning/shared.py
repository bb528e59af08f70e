"""Best displacement that many particles can share under one field.

Positions are complex numbers z [m]. A particle responds to U = ∫u dt [s], equal for all, with the
displacement cU, where c = v e^{iφ} [m/s] is its own. Source: PAPER, "What the first-order model
implies for control".
"""

from __future__ import annotations

import numpy as np

from microbot_ros.control.contract import Workspace


def as_complex(position: np.ndarray) -> np.ndarray:
    """Convert vectors, such as a `position`, (..., 2) to complex numbers (...).

    Parameters
    ----------
    position : ndarray, shape (..., 2)
        Vectors.

    Returns
    -------
    ndarray, shape (...)
        Complex numbers.
    """
    return position[..., 0] + 1j * position[..., 1]


def best_displacement(velocity: np.ndarray, wanted: np.ndarray) -> complex:
    """Return U* = Σ c̄ᵢ dᵢ / Σ |cᵢ|² [s], the displacement with the smallest squared error.

    `velocity` c (N,) [m/s]; `wanted` d = g − z (N,) [m]. Zero if no particle moves.

    Parameters
    ----------
    velocity : ndarray, shape (N,)
        Velocity phasors v e^{iφ} [m/s].
    wanted : ndarray, shape (N,)
        Vectors to the goals, complex [m].

    Returns
    -------
    complex
        U* [s].
    """
    power = np.vdot(velocity, velocity).real
    return complex(np.vdot(velocity, wanted) / power) if power > 0 else 0j


def floor(velocity: np.ndarray, wanted: np.ndarray) -> float:
    """Return the RMS distance [m] from the goals below which no controller gets in first order.

    `velocity` (N,) [m/s] and `wanted` (N,) [m] as for `best_displacement`.

    Parameters
    ----------
    velocity : ndarray, shape (N,)
        Velocity phasors v e^{iφ} [m/s].
    wanted : ndarray, shape (N,)
        Vectors to the goals, complex [m].

    Returns
    -------
    float
        Distance [m].
    """
    left = wanted - velocity * best_displacement(velocity, wanted)
    return float(np.sqrt(np.mean(np.abs(left) ** 2))) if len(left) else 0.0


def borders(workspace: Workspace, position: np.ndarray, velocity: np.ndarray,
            margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the constraints Re(n̄ U) ≤ h that keep all particles inside the workspace.

    Since the workspace is convex, no particle leaves it on the straight path of an allowed
    displacement.

    Parameters
    ----------
    workspace : Workspace
        Rectangle that the particles must not leave.
    position : (N, 2) array [m]
        Positions of the particles.
    velocity : (N,) complex array
        Velocity phasors c [m/s].
    margin : float [m]
        Distance to keep from each border.

    Returns
    -------
    n : (4N,) complex array [m/s]
        Normals of the constraints, four borders for each particle.
    h : (4N,) array [m]
        Negative for a particle nearer to a border than the margin, which must come back.
    """
    room = np.concatenate([workspace.high - margin - position, position - workspace.low - margin])
    normal = np.concatenate([velocity.conj(), 1j * velocity.conj(),
                             -velocity.conj(), -1j * velocity.conj()])
    count = len(position)
    by_side = np.concatenate([room[:count].T, room[count:].T]).ravel()
    return normal, by_side


def nearest_allowed(wanted: complex, normal: np.ndarray, room: np.ndarray) -> complex:
    """Return the U [s] nearest to `wanted` with Re(n̄ U) ≤ h; `normal` n and `room` h are (K,).

    If there is none, particles beyond a border may stay as far out as they are. The nearest is the
    best, since the squared error of `best_displacement` grows by Σ|cᵢ|² |U − U*|².

    Parameters
    ----------
    wanted : complex
        Wanted U [s].
    normal : ndarray, shape (K,)
        Normals n, complex.
    room : ndarray, shape (K,)
        Bounds h.

    Returns
    -------
    complex
        U [s].
    """
    if _allowed(np.array([wanted]), normal, room)[0]:
        return complex(wanted)
    candidates = np.concatenate([_feet(wanted, normal, room), allowed_corners(normal, room)])
    candidates = candidates[_allowed(candidates, normal, room)]
    if not len(candidates):
        return nearest_allowed(wanted, normal, np.maximum(room, 0.0))
    return complex(candidates[np.argmin(np.abs(candidates - wanted))])


def _feet(wanted: complex, normal: np.ndarray, room: np.ndarray) -> np.ndarray:
    """Return the foot of the perpendicular from `wanted` on each border."""
    power = np.abs(normal) ** 2
    some = power > 0
    excess = (normal.conj() * wanted).real[some] - room[some]
    return np.asarray(wanted - normal[some] * excess / power[some])


def allowed_corners(normal: np.ndarray, room: np.ndarray) -> np.ndarray:
    """Return the corners of the region given by `normal` and `room`, and U = 0 if inside.

    Parameters
    ----------
    normal : ndarray, shape (K,)
        Normals n, complex.
    room : ndarray, shape (K,)
        Bounds h.

    Returns
    -------
    ndarray
        Corners, complex [s].
    """
    a, b = np.triu_indices(len(normal), 1)
    cross = (normal[a].conj() * normal[b]).imag
    some = np.abs(cross) > 1e-9 * np.abs(normal[a]) * np.abs(normal[b])
    a, b, cross = a[some], b[some], cross[some]
    points = np.append(1j * (room[b] * normal[a] - room[a] * normal[b]) / cross, 0j)
    return np.asarray(points[_allowed(points, normal, room)])


def _allowed(points: np.ndarray, normal: np.ndarray, room: np.ndarray) -> np.ndarray:
    slack = room - (normal.conj() * points[:, None]).real
    return np.asarray((slack >= -1e-12 - 1e-9 * np.abs(room)).all(1))
