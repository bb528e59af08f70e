"""Rotation of the camera relative to the coils, from tracks under known commands.

A particle moves by v e^{iφ} u for a field along u. In an image that is rotated by ρ it moves by
v e^{i(φ−ρ)} u. Only a convention separates rotation and φ: that φ is zero on average over the
particles, or known. In a mirrored image particles turn against the command, so handedness needs no
convention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.estimation.batch import fit

CLEARLY = 10.0
"""Log likelihood by which one handedness must exceed the other.

Choice: odds of 22,000 to 1; less would let commands that hardly turn decide.
"""

USABLE = 0.5
"""Standard deviation of φ [rad] above which a particle does not contribute. Choice: 29°."""

KNOWN = math.pi / 4
"""Half-width [rad] of the 95 % interval above which the rotation counts as unknown.

Choice: 45°, beyond which a correction may make it worse.
"""


@dataclass(frozen=True)
class CameraTurn:
    """Handedness and rotation of a camera, from K usable particles.

    Attributes
    ----------
    mirrored : bool
        Whether particles turn against the command in the image.
    log_odds : float
        Difference in log likelihood.
    ids : ndarray, shape (K,)
        The particles.
    angle, angle_std : ndarray, shape (K,)
        Direction of travel less the command and φ [rad], after unmirroring, and standard
        deviation.
    turn : float
        Common angle [rad].
    interval : float
        Half-width of its 95 % interval [rad].
    phi_known : bool
        Whether φ was given.
    """

    mirrored: bool
    log_odds: float
    ids: np.ndarray
    angle: np.ndarray
    angle_std: np.ndarray
    turn: float
    interval: float
    phi_known: bool

    @property
    def known(self) -> bool:
        """Whether the particles have a common direction."""
        return self.interval < KNOWN

    def corrected(self, rotation: float, mirrored: bool) -> tuple[float, bool]:
        """Return the settings that `ImageToWorkspace` should have had.

        Parameters
        ----------
        rotation : float
            Rotation with which the tracks were recorded [rad].
        mirrored : bool
            Mirroring with which the tracks were recorded.

        Returns
        -------
        (float, bool)
            Corrected rotation [rad] and mirroring. If the turn is unknown, only the mirroring is
            corrected.
        """
        turn = self.turn if self.known else 0.0
        if self.mirrored:
            rotation, mirrored = -rotation, not mirrored
        return math.remainder(rotation - turn, 2 * math.pi), mirrored


def camera_turn(session: Session, phi: float | None = None) -> CameraTurn:
    """Estimate handedness and rotation of the camera.

    Parameters
    ----------
    session : Session
        Particles under commands in several directions.
    phi : float, optional
        Angle from the field to the motion of every particle [rad], such as 0 for rollers; by
        default it is zero on average.

    Returns
    -------
    CameraTurn
        The estimate.

    Raises
    ------
    InputError
        If no particle answers the commands, or the commands do not show the handedness.
    """
    mirror = replace(
        session, commands=replace(session.commands, field=session.commands.field * (1.0, -1.0)))
    straight, turned = fit(session), fit(mirror)
    odds = turned.log_likelihood - straight.log_likelihood
    best, mirrored = (turned, True) if odds > 0 else (straight, False)
    usable = best.polar.phi_std < USABLE
    if not usable.any():
        raise InputError(session.name or 'session', 'expected particles that respond to the '
                                                    'commands; no direction of motion follows '
                                                    'them')
    if not abs(odds) > CLEARLY:
        raise InputError(
            session.name or 'session', 'expected commands that show whether the picture is '
            f'mirrored (log odds {odds:.1f}, needed ±{CLEARLY:g}): command at least three '
            'directions all round, each for some seconds')
    angle = best.polar.phi[usable] * (-1 if mirrored else 1) - (phi or 0.0)
    std = best.polar.phi_std[usable]
    turn, interval = _common(angle, std) if phi is not None else _mean(angle)
    return CameraTurn(mirrored, abs(odds), best.ids[usable], np.angle(np.exp(1j * angle)), std,
                      turn, interval, phi is not None)


def _mean(angle: np.ndarray) -> tuple[float, float]:
    """Return the mean of angles (N,) [rad] and half its 95 % interval, for any distribution.

    From the circular dispersion (N. I. Fisher, Statistical Analysis of Circular Data, 1993,
    §4.4.4), with Student's t for few; infinite for one.
    """
    from scipy.stats import t as student

    count, mean = len(angle), np.mean(np.exp(1j * angle))
    turn = float(np.angle(mean))
    if count < 2:
        return turn, math.inf
    second = float(np.mean(np.cos(2 * (angle - turn))))
    length = max(float(np.abs(mean)), 1e-9)
    dispersion = (1 - second) / (2 * length**2) * count / (count - 1)
    return turn, float(student.ppf(0.975, count - 1) * math.sqrt(dispersion / count))


def _common(angle: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Return the weighted mean of equal angles (N,), and half its 95 % interval.

    Widened by √(χ²/(N − 1)) if they scatter more than their errors.
    """
    weight = 1 / std**2
    turn = float(np.angle(np.sum(weight * np.exp(1j * angle))))
    chi_square = float(np.sum(weight * np.angle(np.exp(1j * (angle - turn))) ** 2))
    widened = max(1.0, chi_square / max(len(angle) - 1, 1))
    return turn, 1.96 * math.sqrt(widened / float(np.sum(weight)))
