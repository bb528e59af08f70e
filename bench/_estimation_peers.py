"""What the estimators are measured against: recursive least squares on increments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.model.model import Model
from microbot_ros.model.timeline import Timeline


@dataclass(frozen=True)
class LeastSquares:
    """Gains c (N,) complex with their own standard deviations per axis (N,)."""

    gain: np.ndarray
    std: np.ndarray


def recursive_least_squares(session: Session) -> LeastSquares:
    """Least squares of increments on ∫u dt, as if their noise were white.

    In batch form, which is what the recursion computes when it forgets nothing.
    """
    times, positions = session.tracks.grid()
    z = positions[..., 0] + 1j * positions[..., 1]
    model = Model.baseline(session.conditions, session.commands)
    path = ExpectedDisplacement.of(model, Timeline(session.commands, times)).along[:, 0]
    gains, stds = [], []
    for track in z.T:
        seen = np.isfinite(track)
        moved, drive = np.diff(track[seen]), np.diff(path[seen])
        power = (np.abs(drive) ** 2).sum()
        gain = (np.conj(drive) * moved).sum() / power
        left = moved - gain * drive
        gains.append(gain)
        stds.append(np.sqrt((np.abs(left) ** 2).sum() / (2 * len(left)) / power))
    return LeastSquares(np.array(gains), np.array(stds))
