"""What all particles share, learned from a sliding window: noise levels, delay, excitation."""

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
"""Seconds from the first frame to the first review; seconds between reviews at most."""

SLICE_EVERY, MOST_SLICES = 0.01, 8
"""One slice of a review for so long [s] since the frame before, at most so many for one frame: a
review takes as long at 20 frames a second as at 100."""

DOUBTED = 10.0
"""Seconds for which most particles are restless until the noise levels are doubted, rather than
the particles: a stage that is moved is no noise."""

PRIOR_LOG_STD = 1.0
"""How far D and σ² may be from what was assumed, as a standard deviation of their logarithm."""


class SharedKnowledge:
    """Noise and delay in use, renewed by reviews that are worked off a slice per frame.

    They begin with an assumed `noise`.
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
        """When most particles were last not restless [s]."""

    def forget_model(self) -> None:
        """Drop what was learned under another model, but the noise levels."""
        self.delay, self.log_phasor_slope, self.sentences = Delay(), 0j, ()
        self._review = None

    def add(self, t: float, ids: np.ndarray, readings: Readings,
            changed: list[tuple[int, float]]) -> None:
        """A frame at `t` [s] of particles `ids` (N,) with its `readings`.

        `changed`: rows whose velocity phasor changed, and how long ago [s]. From restless ones
        nothing is learned, unless most have been so for long.
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
        """Go on with a review at `t` [s], if one is due or under way.

        Under a `model` and the commands of a `log`. True where a new delay corrected the
        velocity phasors of the `population`.
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
        # What the filter learned under the old delay, it would have learned turned by this.
        factor = np.exp(review.log_phasor_slope * (review.delay.value - self.delay.value))
        population.correct_velocity_phasors(factor)
        self.delay = review.delay
        return bool(abs(factor - 1) > 0.01)


def _shrunk(prior: Noise, fitted: Noise) -> Noise:
    """The fitted levels, drawn towards the assumed ones as far as the data are poor."""
    def draw(assumed: float, value: float, std: float) -> float:
        trust = (PRIOR_LOG_STD * value) ** 2 / ((PRIOR_LOG_STD * value) ** 2 + std**2)
        return float(assumed * (value / assumed) ** trust)

    return replace(
        fitted,
        diffusion=draw(prior.diffusion, fitted.diffusion, fitted.diffusion_std),
        localisation=draw(prior.localisation, fitted.localisation, fitted.localisation_std),
    )
