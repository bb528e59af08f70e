"""The cap in the learned picture: first and second angular harmonics, and the true centre."""

from __future__ import annotations

import numpy as np

from microbot_ros.tracking.refine.fit import TABLE_STEP
from microbot_ros.tracking.refine.profiles import Samples


def first_harmonic(pixels: Samples, rest: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return coefficients (K,) of the one-sided radial profile of many particles, up to sign.

    It is the leading direction of all particles' residuals, whichever way each one points.
    `pixels` have P samples, `rest` (P,) is their residual from the round picture, `basis` (P, K)
    the radial functions.

    Parameters
    ----------
    pixels : Samples
        Samples of pixels.
    rest : ndarray, shape (P,)
        Residuals.
    basis : ndarray, shape (P, K)
        Radial functions.

    Returns
    -------
    ndarray, shape (K,)
        Coefficients.
    """
    total = np.zeros((basis.shape[1],) * 2)
    for k in range(pixels.owner.max() + 1):
        mine = pixels.owner == k
        contrast, radial = pixels.weight[mine][0], basis[mine]
        angle = pixels.angle[mine, None]
        design = np.hstack([radial * np.cos(angle), radial * np.sin(angle)])
        normal = design.T @ design
        normal += 1e-3 * np.trace(normal) / len(normal) * np.eye(len(normal))
        along, across = np.split(np.linalg.solve(normal, design.T @ rest[mine]), 2)
        total += contrast**2 * (np.outer(along, along) + np.outer(across, across))
    leading: np.ndarray = np.linalg.eigh(total)[1][:, -1]
    return leading


def centre_shift(table: np.ndarray, reach_px: float) -> float:
    """Return how far [px] along θ the particle's centre lies from the fitted one.

    Metal that covers one half of a sphere, seen from the side, and its mirror image add up to a
    round picture: about the true centre there is no second harmonic. From a point s off the
    centre, f₂ is s/2·(f₁′ − f₁/r), so that part of f₂ gives s. `table` (3, K) holds f₀, f₁ and f₂
    in steps of `TABLE_STEP` px, used up to `reach_px`.

    Parameters
    ----------
    table : ndarray, shape (3, K)
        Profiles f₀, f₁ and f₂.
    reach_px : float
        Largest radius that is used [px].

    Returns
    -------
    float
        Distance [px].
    """
    radii = np.arange(table.shape[1]) * TABLE_STEP
    near = (radii > 1) & (radii < reach_px)
    r, (f1, f2) = radii[near], table[1:, near]
    shape = 0.5 * (np.gradient(f1, TABLE_STEP) - f1 / r)
    return float(-np.sum(r * shape * f2) / np.sum(r * shape**2))
