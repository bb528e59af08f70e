"""Where a search may begin: coarse looks at white residuals, before a few places are fitted.

What swings shows in a periodogram. For what pushes at a place, residuals are summed over blocks
of time in which a particle hardly moves: a slow field passes the whitening filter as a constant
times itself, so that the score against it needs no filter: (Σ R·v)² / Σ n|v|².
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ros.estimation.likelihood import SessionFit
from microbot_ros.estimation.model_fit import ModelFit
from microbot_ros.model.effects.hot_spot import HotSpot

PADDING = 4
"""Frequencies looked at for every independent one."""

BLOCK = 1.0
"""Seconds over which residuals are summed."""

APART = 1.0
"""Widths by which two places differ."""


def rotating_components(
    times: np.ndarray, signal: np.ndarray, fastest: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (F,) [Hz] and the components (F,) of a `signal` that rotate either way.

    Σ s e^{∓iωt} of a complex `signal` (T,) at `times` (T,) [s], forwards and backwards, from one
    period a recording to `fastest` [Hz]. Frames are put on an even grid of the usual interval,
    half of which no period comes near.
    """
    h = float(np.median(np.diff(times)))
    slot = np.rint((times - times[0]) / h).astype(int)
    even = np.zeros(PADDING * (slot[-1] + 1), complex)
    np.add.at(even, slot, signal)
    forward = np.fft.fft(even)
    frequency = np.fft.fftfreq(len(even), h)
    use = np.flatnonzero((frequency >= 1 / (slot[-1] * h)) & (frequency <= fastest))
    turned = np.exp(2j * np.pi * frequency[use] * times[0])
    return frequency[use], forward[use] * turned.conj(), forward[-use] * turned


@dataclass(frozen=True)
class _Blocks:
    """Sums of white residuals, their number, and the place in the middle, (B, N) each."""

    residual: np.ndarray
    count: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, p: SessionFit) -> _Blocks:
        times = p.session.times
        first = np.unique(((times - times[0]) / BLOCK).astype(int), return_index=True)[1]
        middle = (first + np.append(first[1:], len(times))) // 2
        x = p.session.causal_positions[middle]
        return cls(np.add.reduceat(p.residual, first, axis=0),
                   np.add.reduceat(p.residual != 0, first, axis=0), x[..., 0] + 1j * x[..., 1])


def likely_spots(fit: ModelFit, grid: Iterable[HotSpot], count: int) -> list[HotSpot]:
    """The best `count` of a `grid` of spots beside a `fit`, no two at one place, best first."""
    spots = list(grid)
    blocks = [_Blocks.of(p) for p in fit.session_fits]
    slope, information = np.array([_score(blocks, spot) for spot in spots]).T
    # Where hardly anybody came by, nothing can be seen.
    power = slope**2 / (information + 1e-3 * information.max())
    chosen: list[HotSpot] = []
    for k in np.argsort(-power):
        if all(_apart(spots[k], other) for other in chosen):
            chosen.append(spots[k])
        if len(chosen) == count:
            break
    return chosen


def _apart(one: HotSpot, other: HotSpot) -> bool:
    distance = np.hypot(one.x - other.x, one.y - other.y)
    return bool(distance > APART * max(one.width, other.width))


def _score(blocks: Sequence[_Blocks], spot: HotSpot) -> tuple[float, float]:
    """Slope and information of the spot's speed."""
    slope = information = 0.0
    for block in blocks:
        away = (block.place - complex(spot.x, spot.y)) / spot.width
        push = np.nan_to_num(away * np.exp(0.5 - np.abs(away) ** 2 / 2))
        slope += float((block.residual * push.conj()).real.sum())
        information += float((block.count * np.abs(push) ** 2).sum())
    return slope, information
