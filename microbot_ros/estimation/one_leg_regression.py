"""The paper's own method: terminal speed by a linear regression over one straight leg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.common.records import Commands, Session


@dataclass(frozen=True)
class Leg:
    """Regression of one particle over one leg.

    Standard deviations are those of ordinary least squares, which assume independent positions:
    they are too small. All are NaN if no leg of constant command has three sightings.

    Attributes
    ----------
    speed, speed_std : float
        Speed and standard deviation [m/s, or m/s/Hz].
    phi, phi_std : float
        Angle of travel from the field and standard deviation [rad].
    start, end : float
        Start and end of the leg [s].
    """

    speed: float
    speed_std: float
    phi: float
    phi_std: float
    start: float
    end: float


_NONE = Leg(*[np.nan] * 6)
"""Result without a leg."""


def one_leg(session: Session) -> list[Leg]:
    """Apply the method to every particle, over the longest time of one command.

    Parameters
    ----------
    session : Session
        The recording.

    Returns
    -------
    list of Leg
        One for each particle.
    """
    times, positions = session.tracks.grid()
    z = positions[..., 0] + 1j * positions[..., 1]
    rolling = session.conditions.propulsion == 'rolling'
    start, end, drive = _longest(session.commands, rolling, float(times[-1]), float(times[0]))
    inside = (times >= start) & (times <= end)
    return [_regress(times[inside], track[inside], drive) for track in z.T]


def _longest(
    commands: Commands, rolling: bool, last: float, first: float,
) -> tuple[float, float, complex]:
    """Return start, end [s] and drive of the longest time of one command in the recording."""
    drive = commands.field[:, 0] + 1j * commands.field[:, 1]
    strength = np.abs(drive)
    drive = np.where(strength > 0, drive / np.where(strength > 0, strength, 1), 0)
    if rolling and commands.frequency is not None:
        drive = drive * commands.frequency
    new = np.append(True, drive[1:] != drive[:-1]) if len(drive) else np.zeros(0, bool)
    starts, drive = np.clip(commands.t[new], first, last), drive[new]
    ends = np.append(starts[1:], last)
    length = np.where(drive != 0, ends - starts, -1)
    if not (length > 0).any():
        return np.inf, -np.inf, 0j
    k = int(length.argmax())
    return float(starts[k]), float(ends[k]), complex(drive[k])


def _regress(times: np.ndarray, z: np.ndarray, drive: complex) -> Leg:
    seen = np.isfinite(z)
    if seen.sum() < 3:
        return _NONE
    t, z = times[seen] - times[seen].mean(), z[seen]
    power = float((t**2).sum())
    velocity = complex((t * z).sum() / power)
    left = z - z.mean() - velocity * t
    std = float(np.sqrt((np.abs(left) ** 2).sum() / (2 * (len(t) - 2)) / power))
    gain = velocity / drive
    return Leg(
        abs(gain), std / abs(drive), float(np.angle(gain)), std / max(abs(velocity), 1e-30),
        float(times[seen][0]), float(times[seen][-1]),
    )
