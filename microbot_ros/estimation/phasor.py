"""From the complex gain c = v exp(iφ) to speed and direction, with honest spreads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import i0e, i1e


@dataclass(frozen=True)
class Polar:
    """Speed [m/s, or m/s/Hz] and direction offset [rad] with their standard deviations."""

    speed: np.ndarray
    speed_std: np.ndarray
    phi: np.ndarray
    phi_std: np.ndarray


def polar(c: np.ndarray, std: np.ndarray) -> Polar:
    """Speed |c| and phase arg c of c known to `std` on each axis; arrays of one shape.

    Moments of the Rice likelihood under a flat prior on speed ≥ 0: |c| alone is biased upwards
    by std²/2v. Where c drowns in its own spread the speed is that of a half-normal, and the
    phase's standard deviation tends to that of a uniform angle, π/√3; nothing diverges.
    With y = |c|²/2 std²: E v = std √(2/π) / (e^{−y/2} I₀(y/2)),
    E v² = std² (1 + y + y I₁(y/2)/I₀(y/2)); the phase's mean resultant length is
    √(πy)/2 · e^{−y/2} (I₀(y/2) + I₁(y/2)).
    """
    std = np.maximum(std, 1e-30)
    y = np.minimum((np.abs(c) / std) ** 2 / 2, 1e12)
    i0, i1 = i0e(y / 2), i1e(y / 2)
    mean = std * np.sqrt(2 / np.pi) / i0
    # For large y the difference of squares cancels: the spread is `std` to 1 part in 4y.
    square = std**2 * (1 + y + y * i1 / i0)
    spread = np.where(y > 1e4, std, np.sqrt(np.maximum(square - mean**2, 0)))
    resultant = np.clip(np.sqrt(np.pi * y) / 2 * (i0 + i1), 1e-300, 1)
    phase = np.where(
        y > 1e4, 1 / np.sqrt(2 * np.maximum(y, 1)), np.sqrt(-2 * np.log(resultant))
    )
    return Polar(mean, spread, np.angle(c), np.minimum(phase, np.pi / np.sqrt(3)))
