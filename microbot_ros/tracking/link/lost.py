"""Those who went unseen for too long to be carried on: where each may be, and who came back."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.tracking.link.assign import Pairs, assign
from microbot_ros.tracking.link.looks import LOOKS_SPREAD, looks
from microbot_ros.tracking.link.states import PLACE, TrackStates

_REACH = 5.0
"""Standard deviations of its place within which one that is lost is looked for."""


class Lost:
    """Remembers particles with their looks, and lets the region in which each may be grow.

    Its motion makes the region; one is forgotten when it is so large that a stranger is as likely
    anywhere in it. `states` are those remembered.
    """

    def __init__(self, nobody: TrackStates) -> None:
        self.states = nobody

    def forget(self, strangers: float, size: tuple[int, int]) -> None:
        """Forget who can't be known again, and who has left a picture of `size` (height, width).

        `strangers` [1/px²] turn up in a frame.
        """
        states = self.states
        x, y = states.xy.T
        likely = np.log(2 * math.pi * self._variance) + self._unlikely < -math.log(strangers)
        inside = (x > -0.5) & (y > -0.5) & (x < size[1] - 0.5) & (y < size[0] - 0.5)
        if not (likely & inside).all():
            self.states = states.take(likely & inside)

    def returned(self, fresh: TrackStates, strangers: float) -> Pairs:
        """Who of the remembered is which of the `fresh`, rather than one of the `strangers`.

        `strangers` [1/px²] turn up in a frame.
        """
        states = self.states
        return assign(
            states.xy, self._variance, _REACH * np.sqrt(self._variance),
            looks(states.contrast, states.radius, states.kind), self._unlikely, fresh.xy,
            fresh.sigma**2, looks(fresh.contrast, fresh.radius, fresh.kind), LOOKS_SPREAD,
            strangers)

    @property
    def _variance(self) -> np.ndarray:
        """Of each one's place (N,), per coordinate [px²]."""
        return self.states.covariance[:, PLACE, PLACE].real.copy()

    @property
    def _unlikely(self) -> np.ndarray:
        """−ln (N,) of the odds to come back just now: after n frames without, 1 in n + 1."""
        return np.asarray(np.log1p(self.states.missed))
