"""Noise, delay and excitation that all particles share, learned from a sliding window."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from microbot_ros.estimation.likelihood.delay import Delay
from microbot_ros.estimation.likelihood.noise import Noise
from microbot_ros.estimation.online.commands import CommandLog
from microbot_ros.estimation.online.population import Population, Readings
from microbot_ros.estimation.online.window import Review, Window
from microbot_ros.model.model import Model

FIRST_REVIEW, REVIEW_EVERY = 0.5, 4.0
"""Time [s] from the first frame to the first review, and between reviews at most (`REVIEW_EVERY`).

Choice: the first has enough increments; more frequent ones cost time of every frame.
"""

SLICE_EVERY, MOST_SLICES = 0.01, 8
"""Time [s] since the last frame for each slice of a review, and the most slices in one frame
(`MOST_SLICES`).

Choice: a review takes as long at 20 frames a second as at 100."""

DOUBTED = 10.0
"""Time [s] for which most particles must be restless for the noise levels to be doubted instead.

Choice: longer than a stage is moved, which is no noise.
"""

PRIOR_LOG_STD = 1.0
"""Prior standard deviation of log D and log σ² about what was assumed. Choice: a factor of e."""


class SharedKnowledge:
    """Noise and delay in use, updated by reviews that run one slice per frame.

    Parameters
    ----------
    noise : Noise
        Noise that is assumed at first.
    """

    def __init__(self, noise: Noise) -> None:
        self._prior = noise
        self.noise = noise
        self.delay = Delay()
        self.log_phasor_slope = 0j
        self.sentences: tuple[str, ...] = ()
        self.reviewed = False
        self._window = Window()
        self._review: Iterator[Review | None] | None = None
        self._next: float | None = None
        self._pause = FIRST_REVIEW
        self._t = -np.inf
        self._settled = -np.inf
        """Last time [s] at which most particles were not restless."""

    def forget_model(self) -> None:
        """Drop what was learned under another model, except the noise levels."""
        self.delay, self.log_phasor_slope, self.sentences = Delay(), 0j, ()
        self._review = None

    def add(self, t: float, ids: np.ndarray, readings: Readings,
            changed: list[tuple[int, float]]) -> None:
        """Add a frame.

        Nothing is learned from restless particles, unless most have been restless for long.

        Parameters
        ----------
        t : float
            Time [s].
        ids : ndarray of int, shape (N,)
            Particles.
        readings : Readings
            Readings of the frame.
        changed : list of (int, float)
            Indices of particles whose velocity phasor changed, and how long ago [s].
        """
        restless = readings.restless
        if 2 * np.count_nonzero(restless) <= len(ids) or self._settled == -np.inf:
            self._settled = t
        for row, ago in changed:
            self._window.changed(int(ids[row]), t - ago)
        if t - self._settled > DOUBTED:
            self._window.add(t, ids, readings.z, readings.seen)
            return
        for row in readings.jumped:
            if restless[row]:
                self._window.changed(int(ids[row]), t)
            else:
                self._window.jumped(int(ids[row]), complex(readings.jump[row]))
        self._window.add(t, ids, readings.z, readings.used & ~restless)

    def work(self, t: float, model: Model, log: CommandLog, population: Population) -> bool:
        """Continue a review, if one is due or in progress.

        Parameters
        ----------
        t : float
            Time [s].
        model : Model
            Model of the filter.
        log : CommandLog
            Commands.
        population : Population
            Particles, whose velocity phasors a new delay corrects.

        Returns
        -------
        bool
            Whether velocity phasors changed by more than 1 %.
        """
        span, self._t = t - self._t, t
        if self._next is None:
            self._next = t + self._pause
        if self._review is None:
            if t < self._next:
                return False
            self._pause = min(2 * self._pause, REVIEW_EVERY)
            self._next = t + self._pause
            self._review = self._window.review(model, log, self.delay, self.noise)
        try:
            for _ in range(round(min(max(span / SLICE_EVERY, 1), MOST_SLICES))):
                if (result := next(self._review)) is not None:
                    self._review = None
                    return self._adopt(result, population)
        except StopIteration:
            self._review = None
        return False

    def _adopt(self, review: Review, population: Population) -> bool:
        noise = _shrunk(self._prior, review.noise)
        if not (math.isfinite(noise.diffusion) and math.isfinite(noise.localisation)):
            return False
        self.noise = noise
        self.log_phasor_slope, self.sentences = review.log_phasor_slope, review.confounded
        self.reviewed = True
        if not review.delay.determined:
            self.delay = replace(self.delay, std=np.nan)
            return False
        # Under the new delay the filter would have learned velocity phasors times this factor.
        factor = np.exp(review.log_phasor_slope * (review.delay.value - self.delay.value))
        population.correct_velocity_phasors(factor)
        self.delay = review.delay
        return bool(abs(factor - 1) > 0.01)


def _shrunk(prior: Noise, fitted: Noise) -> Noise:
    """Return the fitted levels, shrunk towards the assumed ones as far as the data are poor."""
    def draw(assumed: float, value: float, std: float) -> float:
        trust = (PRIOR_LOG_STD * value) ** 2 / ((PRIOR_LOG_STD * value) ** 2 + std**2)
        return float(assumed * (value / assumed) ** trust)

    return replace(
        fitted,
        diffusion=draw(prior.diffusion, fitted.diffusion, fitted.diffusion_std),
        localisation=draw(prior.localisation, fitted.localisation, fitted.localisation_std),
    )
