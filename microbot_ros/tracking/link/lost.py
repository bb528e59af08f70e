"""Particles missed for too long to be carried on: where they may be, and their return."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.tracking.link.assign import Pairs, assign
from microbot_ros.tracking.link.looks import LOOKS_SPREAD, looks
from microbot_ros.tracking.link.states import PLACE, TrackStates

_REACH = 5.0
"""Choice: standard deviations of its position within which a lost particle is searched."""


class Lost:
    """Remembers lost particles and their traits, with a growing region in which each may be.

    The region grows by the particle's motion; a particle is forgotten when a stranger is as likely
    anywhere in it. `states` are those remembered, `nobody` the empty start.

    Parameters
    ----------
    nobody : TrackStates
        States of no particle.
    """

    def __init__(self, nobody: TrackStates) -> None:
        self.states = nobody

    def forget(self, strangers: float, size: tuple[int, int]) -> None:
        """Forget particles that cannot be recognised any more or have left the picture.

        `size` is (height, width); `strangers` [1/px²] appear per frame.

        Parameters
        ----------
        strangers : float
            New particles per frame and area [1/px²].
        size : tuple[int, int]
            Height and width of the pictures [px].
        """
        states = self.states
        x, y = states.xy.T
        likely = np.log(2 * math.pi * self._variance) + self._unlikely < -math.log(strangers)
        inside = (x > -0.5) & (y > -0.5) & (x < size[1] - 0.5) & (y < size[0] - 0.5)
        if not (likely & inside).all():
            self.states = states.take(likely & inside)

    def returned(self, fresh: TrackStates, strangers: float) -> Pairs:
        """Match the remembered particles with `fresh` ones, against `strangers`.

        `strangers` [1/px²] appear per frame.

        Parameters
        ----------
        fresh : TrackStates
            States of new particles.
        strangers : float
            New particles per frame and area [1/px²].

        Returns
        -------
        Pairs
            The pairs.
        """
        states = self.states
        return assign(
            states.xy, self._variance, _REACH * np.sqrt(self._variance),
            looks(states.contrast, states.radius, states.kind), self._unlikely, fresh.xy,
            fresh.sigma**2, looks(fresh.contrast, fresh.radius, fresh.kind), LOOKS_SPREAD,
            strangers)

    @property
    def _variance(self) -> np.ndarray:
        """Variance (N,) of each position, per coordinate [px²]."""
        return self.states.covariance[:, PLACE, PLACE].real.copy()

    @property
    def _unlikely(self) -> np.ndarray:
        """−ln (N,) of the probability to return now: after n frames, 1 in n + 1."""
        return np.asarray(np.log1p(self.states.missed))
