"""Where something pushes: a coarse look at hundreds of places, before a few are fitted.

White residuals are summed over blocks of time in which a particle hardly moves. A slow field
passes the whitening filter as a constant times itself, so that the score against it needs no
filter: (Σ R·v)² / Σ n|v|².
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ros.discovery.likelihood import Fit, Part
from microbot_ros.model.effects.hot_spot import HotSpot

BLOCK = 1.0
"""Seconds over which residuals are summed."""

APART = 1.0
"""Widths by which two places differ."""


@dataclass(frozen=True)
class _Blocks:
    """Sums of white residuals, their number, and the place in the middle, (B, N) each."""

    residual: np.ndarray
    count: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, p: Part) -> _Blocks:
        times = p.evidence.times
        first = np.unique(((times - times[0]) / BLOCK).astype(int), return_index=True)[1]
        middle = (first + np.append(first[1:], len(times))) // 2
        x = p.evidence.places[middle]
        return cls(np.add.reduceat(p.residual, first, axis=0),
                   np.add.reduceat(p.residual != 0, first, axis=0), x[..., 0] + 1j * x[..., 1])


def likely_spots(fit: Fit, grid: Iterable[HotSpot], count: int) -> list[HotSpot]:
    """The best of a grid of spots, no two at one place, best first."""
    spots = list(grid)
    blocks = [_Blocks.of(p) for p in fit.parts]
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
