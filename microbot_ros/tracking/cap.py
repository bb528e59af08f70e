"""The cap in the learned picture: first and second angular harmonics, and where the centre is."""

from __future__ import annotations

import numpy as np

from microbot_ros.tracking.fit import TABLE_STEP
from microbot_ros.tracking.profiles import Samples


def first_harmonic(pixels: Samples, rest: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """The radial profile that the one-sided residuals of many particles share, up to sign.

    `rest` (P,) is what the round picture leaves of the pixels; `basis` (P, K) holds the radial
    functions. Returns the K coefficients: the leading direction of all particles' residuals,
    whichever way each one points.
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


def centre_shift(table: np.ndarray, diameter_px: float, reach_px: float) -> float:
    """How far [px] along θ the outline's centre lies from the fitted one.

    A shift of the centre adds a multiple of f₀′ to f₁. About the true centre of a sphere both
    fade alike at the edge, f₁ ∝ f₀, whatever the cap does inside: so the part of f₁ that looks
    like f₀′ out there is the shift.
    """
    radii = np.arange(table.shape[1]) * TABLE_STEP
    slope = np.gradient(table[0], TABLE_STEP)
    edge = (radii > 0.45 * diameter_px) & (radii < reach_px - 1)
    design = np.column_stack([table[0], -slope])[edge] * np.sqrt(radii[edge])[:, None]
    share = np.linalg.lstsq(design, table[1][edge] * np.sqrt(radii[edge]), rcond=None)[0]
    return float(share[1])
