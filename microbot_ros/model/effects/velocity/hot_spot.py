"""Repulsion from a spot that a laser heats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from microbot_ros.model.effect import Effect, Evidence, Recorded
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter

_WIDTHS = (3, 5, 8, 12, 20)
"""Ratios of the extent of the tracks to starting widths. Choice: a factor of 1.6 apart."""

PASSED = 4
"""Frames for which a particle must be within a width of the spot when it passes through.

Choice: fewer frames look like a step of a track.
"""

VISITS, LITTLE = 3, 0.1
"""Visits within two widths, and fraction of all rows there (`LITTLE`), below both of which the
spot is a single event. Choice: what happened once or twice is no field of place."""


@dataclass(frozen=True)
class HotSpot(Effect):
    """Away from a heated spot: dp/dt += A (r/s) exp(½ − r²/2s²) r̂; maximum A at r = s."""

    id = 'hot_spot'
    stage = 'velocity'
    summary = 'Particles are pushed away from (or drawn to) one heated place.'
    required_excitation = 'tracks that pass the spot on different sides, at about its width'
    confounded_with = ('uniform_drift', 'linear_flow', 'gradient_force', 'speed_decay')
    proportional = True
    lookalike_time = 210.0  # a flow that differs from place to place: docs/decisions/asking.md
    needs_position = True

    x: float = parameter('x_um', 'the spot', -1e-2, 1e-2, 1e-5, shape=True)
    y: float = parameter('y_um', 'the spot', -1e-2, 1e-2, 1e-5, shape=True)
    speed: float = parameter('speed_um_s', 'A, outwards', -1e-4, 1e-4, 1e-6)
    width: float = parameter('width_um', 's', 1e-6, 1e-2, 1e-5, null_value=2e-5, shape=True)

    def drift(self, context: EffectContext) -> np.ndarray:
        away = (context.position - np.array([self.x, self.y])) / self.width
        # Both axes by hand: a sum over an axis of two takes longer than all the rest.
        fall = np.exp(0.5 - (away[..., 0]**2 + away[..., 1]**2) / 2)
        away *= (self.speed * fall)[..., None]
        return away

    @classmethod
    def starts(cls, evidence: Evidence) -> Sequence[Self]:
        return evidence.promising(evidence.likely(cls._grid(evidence), cls._near))

    @classmethod
    def _grid(cls, evidence: Evidence) -> tuple[Self, ...]:
        """Return spots on grids over the area of all tracks, a width apart, for five widths."""
        area = _area(evidence)
        if area is None:
            return (cls.null(),)
        low, high = area
        extent = float(max(high - low))
        return tuple(
            cls(x, y, 0.0, extent / part) for part in _WIDTHS
            for x in np.linspace(low[0], high[0], part + 1).tolist()
            for y in np.linspace(low[1], high[1], part + 1).tolist()
        )

    def _near(self, other: Self) -> bool:
        return bool(np.hypot(self.x - other.x, self.y - other.y) <= max(self.width, other.width))

    def _inside(self, recorded: Recorded) -> np.ndarray:
        """Return rows (T, N) within two widths, which is the reach of the spot."""
        if recorded.positions is None:
            return np.zeros((1, 1), bool)
        away = recorded.positions - np.array([self.x, self.y])
        inside: np.ndarray = np.hypot(*np.moveaxis(away, -1, 0)) < 2 * self.width
        return inside

    def trials(self, evidence: Evidence) -> float:
        """Return the number of places, with equal prior probability for each octave of width.

        A spot may have any size. There are more places for narrow ones, and each pays for all.
        """
        area = _area(evidence)
        if area is None:
            return 1.0
        # A spot reaches over two widths each way.
        return float(max(
            len(_WIDTHS) * np.prod(area[1] - area[0]) / (4 * self.width) ** 2, 1.0))

    def shape_seen(self, evidence: Evidence) -> bool:
        """Return whether tracks show more than the far slope, which could be anything smooth.

        Particles that cross the spot within PASSED frames make a step of a track. Fewer than
        VISITS for little of the time make an event. Neither counts.
        """
        std = evidence.deviations(self)
        recordings = evidence.recordings
        if not self.width > PASSED / 2 * max(_step(recorded) for recorded in recordings):
            return False
        inside = [self._inside(recorded) for recorded in recordings]
        visits = sum(np.count_nonzero(np.diff(one, axis=0, prepend=False) & one) for one in inside)
        if visits < VISITS and max(one.mean() for one in inside) < LITTLE:
            return False
        within = all(p.low < value < p.high for p, value in self.values().items())
        placed = 3 * std['width'] < self.width > max(std['x'], std['y'])
        return within and placed and std['speed'] < abs(self.speed)


def _area(evidence: Evidence) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the lowest and the highest corner (2,) of all tracks [m]; None without places."""
    places = [one.positions.reshape(-1, 2) for one in evidence.recordings
              if one.positions is not None]
    if not places:
        return None
    return (np.nanmin([np.nanmin(one, axis=0) for one in places], axis=0),
            np.nanmax([np.nanmax(one, axis=0) for one in places], axis=0))


def _step(recorded: Recorded) -> float:
    """Return the distance between two frames [m]: half of the way is made in longer steps.

    A particle that rests for most of a recording makes its way in few steps.
    """
    if recorded.positions is None:
        return 0.0
    steps = np.hypot(*np.moveaxis(np.diff(recorded.positions, axis=0), -1, 0))
    steps = np.sort(steps[np.isfinite(steps)])
    way = np.cumsum(steps)
    return float(steps[np.searchsorted(way, way[-1] / 2)]) if len(steps) else 0.0
