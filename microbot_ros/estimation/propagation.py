"""From frame to frame: the commands so far, through the model, to what moves every particle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.estimation.commands import CommandLog
from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model
from microbot_ros.model.timeline import Timeline


@dataclass(frozen=True)
class Step:
    """In `span` [s] a particle moves by c·`drive` + `drift` (1 or N,), complex, c = v e^{iφ}."""

    drive: np.ndarray
    drift: np.ndarray
    span: float


class Propagator:
    """Integrates a model's response exactly between frames, remembering the heading."""

    def __init__(self, model: Model, horizon: float) -> None:
        self.model = model
        self._horizon = horizon
        self.heading = np.zeros(1, complex)
        """e^{i(θ−φ)} (1 or N,) at the last frame; zero where no field has been yet."""
        self.ahead = Step(np.zeros(1, complex), np.zeros(1, complex), horizon)

    def step(
        self, log: CommandLog, delay: float, start: float, end: float, positions: np.ndarray,
    ) -> Step:
        """What happens from `start` to `end` [s]; `ahead` then holds the same for the horizon.

        `positions` (N,) complex [m] at `start`, where effects that depend on place look.
        """
        times = np.array([start, end, end + self._horizon])
        vectors = np.stack([positions.real, positions.imag], axis=-1)
        commands = log.since(start, delay)
        timeline = Timeline(commands, times, np.broadcast_to(vectors, (3, *vectors.shape)))
        response = respond(self.model, timeline, self._remembered(len(positions)))
        moved = response.drift[..., 0] + 1j * response.drift[..., 1]
        now, self.ahead = (
            Step(response.propulsion[k], moved[k], times[k + 1] - times[k]) for k in (0, 1)
        )
        self.heading = response.heading[1]
        return now

    def _remembered(self, particles: int) -> np.ndarray | None:
        """The heading so far, while it is one for all; else let the model reconstruct it."""
        known = self.heading.size == 1 and self.heading[0] != 0
        return self.heading if known else None
