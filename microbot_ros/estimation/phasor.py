"""From the complex gain c = v exp(iφ) to speed, direction and force, with honest spreads."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import i0e, i1e

from microbot_ros.model.particle import Fluid, stokes_drag
from microbot_ros.records import Conditions


@dataclass(frozen=True)
class Polar:
    """Speed [m/s, or m/s/Hz] and direction offset [rad] with their standard deviations."""

    speed: np.ndarray
    speed_std: np.ndarray
    phi: np.ndarray
    phi_std: np.ndarray

    def widened(self, turn: complex, delay_std: float) -> Polar:
        """With what a spread of the delay [s] does, where `turn` is d log c / d delay [1/s].

        Nothing where the delay is not determined (NaN): then it is said that φ hangs on it.
        """
        late = delay_std if np.isfinite(delay_std) else 0.0
        return replace(
            self, speed_std=np.hypot(self.speed_std, self.speed * abs(turn.real) * late),
            phi_std=np.hypot(self.phi_std, abs(turn.imag) * late),
        )

    def force(
        self, conditions: Conditions, drag_relative_std: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """F = 6πηr v [N] and its standard deviation, that of the drag 6πηr included.

        NaN where radius or viscosity are not known, and for rollers.
        """
        radius, viscosity, drag = conditions.radius, conditions.viscosity, np.nan
        if radius and viscosity and conditions.propulsion != 'rolling':
            drag = stokes_drag(Fluid(viscosity), radius)
        force = drag * self.speed
        return force, np.hypot(drag * self.speed_std, drag_relative_std * force)


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
