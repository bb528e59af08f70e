"""Speed, direction and force from the velocity phasor v e^{iφ}, with unbiased uncertainties."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.records import Conditions
from microbot_ros.estimation.likelihood.noise import sphere_in_fluid
from microbot_ros.model.physics.particle import stokes_drag

DRAG_RELATIVE_STD = float(np.hypot(0.05, 0.05))
"""Relative standard deviation of the drag 6πηr.

Choice: 5 % for viscosity, as of 2 °C in water, and 5 % for radius.
"""

NO_ANGLE = math.pi / math.sqrt(3)
"""Standard deviation [rad] of a uniform angle: π/√3."""


@dataclass(frozen=True)
class Polar:
    """Speed and angle of several tracks; arrays of one shape.

    Attributes
    ----------
    speed, speed_std : ndarray
        Speed and standard deviation [m/s, or m/s/Hz].
    phi, phi_std : ndarray
        Angle of travel from the field and standard deviation [rad].
    """

    speed: np.ndarray
    speed_std: np.ndarray
    phi: np.ndarray
    phi_std: np.ndarray

    def widened(self, log_phasor: np.ndarray | complex) -> Polar:
        """Add a further uncertainty of log(v e^{iφ}).

        Parameters
        ----------
        log_phasor : ndarray of complex, shape (N,), or complex
            Standard deviations of the real and the imaginary part.

        Returns
        -------
        Polar
            With larger standard deviations; that of φ is at most NO_ANGLE.
        """
        speed, phi = np.abs(np.real(log_phasor)), np.abs(np.imag(log_phasor))
        return Polar(self.speed, np.hypot(self.speed_std, self.speed * speed),
                     self.phi, np.minimum(np.hypot(self.phi_std, phi), NO_ANGLE))

    def of(self, rows: np.ndarray) -> Polar:
        """Select rows.

        Parameters
        ----------
        rows : ndarray, shape (P,)
            Indices or mask.

        Returns
        -------
        Polar
            The selected rows.
        """
        return Polar(self.speed[rows], self.speed_std[rows], self.phi[rows], self.phi_std[rows])

    def force(self, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
        """Return the propulsive force F = 6πηr v, with the drag at the height above the floor.

        Parameters
        ----------
        conditions : Conditions
            Conditions of the session; the height is taken as stated.

        Returns
        -------
        force, std : ndarray
            Force and standard deviation [N], including that of the drag. NaN if radius or
            viscosity are unknown, and for rollers.
        """
        known = sphere_in_fluid(conditions)
        drag = stokes_drag(*known) if known and conditions.propulsion != 'rolling' else np.nan
        force = drag * self.speed
        return force, np.hypot(drag * self.speed_std, DRAG_RELATIVE_STD * force)


def polar(velocity_phasor: np.ndarray, std: np.ndarray) -> Polar:
    """Return speed |c| and phase arg c of a velocity phasor c.

    These are moments of the Rice likelihood under a flat prior on speed ≥ 0: |c| alone is biased
    upwards by std²/2v. Where c is far below its uncertainty, the speed is that of a half-normal
    distribution, and the standard deviation of the phase tends to π/√3, that of a uniform angle;
    nothing diverges. With y = |c|²/2 std²:

        E v = std √(2/π) / (e^{−y/2} I₀(y/2)),
        E v² = std² (1 + y + y I₁(y/2)/I₀(y/2)),

    and the mean resultant length of the phase is √(πy)/2 · e^{−y/2} (I₀(y/2) + I₁(y/2)).

    Parameters
    ----------
    velocity_phasor : ndarray of complex
        c [m/s, for rollers m/s/Hz].
    std : ndarray
        Standard deviation of c on each axis, of the same shape.

    Returns
    -------
    Polar
        NaN where either argument is NaN.
    """
    from scipy.special import i0e, i1e  # 0.1 s to import; `model` warms this up

    velocity_phasor = np.asarray(velocity_phasor, complex)
    half = _half_square(velocity_phasor, std)
    return Polar(*_moments(velocity_phasor, std, half, i0e(half), i1e(half)))


@numba.njit('f8[::1](c16[:], f8[:])', cache=True)
def _half_square(c, std):  # type: ignore[no-untyped-def]
    """Return y/2 (N,) of `polar`."""
    half = np.empty(len(c))
    for n in range(len(c)):
        size = abs(c[n]) / max(std[n], 1e-30)
        half[n] = min(size * size / 4, 5e11) if size == size else np.nan
    return half


@numba.njit('UniTuple(f8[::1], 4)(c16[:], f8[:], f8[:], f8[:], f8[:])', cache=True,
            error_model='numpy')
def _moments(c, std, half, i0, i1):  # type: ignore[no-untyped-def]
    """Return the fields of `Polar` from c, `std`, y/2 and e^{−y/2} I(y/2) of orders 0 and 1."""
    speed, spread, phase_std = np.empty(len(c)), np.empty(len(c)), np.empty(len(c))
    phase = np.empty(len(c))
    for n in range(len(c)):
        y, width = 2 * half[n], max(std[n], 1e-30)
        speed[n] = width * math.sqrt(2 / math.pi) / i0[n]
        # For large y the difference of squares cancels: the spread is `std` to 1 part in 4y. The
        # speed must not follow from y, which is bounded.
        if y > 1e4:
            size = abs(c[n])
            speed[n] = size * (1 - (width / size) ** 2 / 2)
            spread[n], phase_std[n] = width, width / size
        else:
            square = width**2 * (1 + y + y * i1[n] / i0[n])
            spread[n] = math.sqrt(max(square - speed[n] ** 2, 0.0))
            resultant = min(max(math.sqrt(math.pi * y) / 2 * (i0[n] + i1[n]), 1e-300), 1.0)
            phase_std[n] = min(math.sqrt(-2 * math.log(resultant)), NO_ANGLE)
        phase[n] = math.atan2(c[n].imag, c[n].real)
        if math.isnan(half[n]):
            speed[n] = spread[n] = phase_std[n] = np.nan
    return speed, spread, phase, phase_std
