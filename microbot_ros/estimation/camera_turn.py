"""How the camera is turned against the coils, from tracks under known commands.

A particle goes v e^{iφ} u for a field along u. In a picture that is turned by ρ it goes
v e^{i(φ−ρ)} u, so rotation and φ are told apart only by a convention: that φ is zero on average
over the particles, or known. A mirrored picture turns the other way than the command: handedness
needs no convention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.estimation.batch import fit

CLEARLY = 10.0
"""Log likelihood by which one handedness must beat the other: 1 in 22,000."""

USABLE = 0.5
"""Radians: a φ known less well than this says nothing of the rotation."""

KNOWN = math.pi / 4
"""Half the 95 % interval of the rotation from which it counts as not known."""


@dataclass(frozen=True)
class CameraTurn:
    """What tracks tell of the camera that took them.

    `mirrored`: the picture turns the other way than the command, by `log_odds` in log
    likelihood. `angle` (K,) [rad]: how far each usable particle, of identity `ids` (K,), goes
    beside the command, once unmirrored, φ allowed for; `angle_std` (K,). `turn` [rad] is what
    they have in common, `interval` half of its 95 % interval; `phi_known`: whether φ was stated.
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
        """Whether the particles have a direction in common at all."""
        return self.interval < KNOWN

    def corrected(self, rotation: float, mirrored: bool) -> tuple[float, bool]:
        """`rotation` [rad] and `mirrored` that `ImageToWorkspace` should have had.

        Given are those with which the tracks were taken. Where the turn is not known, only the
        mirroring is put right.
        """
        turn = self.turn if self.known else 0.0
        if self.mirrored:
            rotation, mirrored = -rotation, not mirrored
        return math.remainder(rotation - turn, 2 * math.pi), mirrored


def camera_turn(session: Session, phi: float | None = None) -> CameraTurn:
    """Handedness and turn of the camera, from particles under commands in several directions.

    From the tracks and commands of a `session`. `phi` [rad] is the angle from the field to the
    motion of every particle where it is known, such as 0 for rollers; else it is taken to be zero
    on average. Raises InputError where the particles do not answer the commands, or the commands
    don't show the handedness.
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
    """Mean direction (N,) [rad] and half its 95 % interval, whatever the distribution.

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
    """Weighted mean of angles that should be one (N,), and half its 95 % interval.

    Widened by √(χ²/(N − 1)) where they scatter more than they should.
    """
    weight = 1 / std**2
    turn = float(np.angle(np.sum(weight * np.exp(1j * angle))))
    chi_square = float(np.sum(weight * np.angle(np.exp(1j * (angle - turn))) ** 2))
    widened = max(1.0, chi_square / max(len(angle) - 1, 1))
    return turn, 1.96 * math.sqrt(widened / float(np.sum(weight)))
