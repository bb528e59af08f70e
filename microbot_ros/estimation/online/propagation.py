"""From frame to frame: the commands so far, through the model, to what moves every particle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from microbot_ros.estimation.online.commands import CommandLog
from microbot_ros.model.increments import beyond_learned, heading_response, respond
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.alignment_kernel import integrate_direction
from microbot_ros.model.physics.vectors import as_vectors
from microbot_ros.model.timeline import Timeline

HEADING_MEMORY = 10.0
"""Seconds of commands from which the course of a lagging heading is followed anew."""
_NO_DRIFT = np.zeros(1, complex)


class Step(NamedTuple):
    """In `span` [s] a particle moves by c·`path` + `drift` (1 or N,), complex, c = v e^{iφ}."""

    path: np.ndarray
    drift: np.ndarray
    span: float


class Swarm(NamedTuple):
    """Who is where: `ids` (N,), `position` (N,) complex [m], `velocity_phasor` v e^{iφ} (N,)."""

    ids: np.ndarray
    position: np.ndarray
    velocity_phasor: np.ndarray


class Propagator:
    """Integrates a model's response exactly between frames, remembering the heading."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.heading = np.zeros(1, complex)
        """e^{i(θ−φ)} (1 or N,) at the last frame; zero where no field has been yet."""

    def advance(
        self, log: CommandLog, delay: float, start: float, end: float, swarm: Swarm,
    ) -> Step:
        """What happens from `start` to `end` [s], the next frame; the heading goes on with it.

        Under the commands of `log`, `delay` [s] late; of a `swarm` as it is at `start`.
        """
        step, self.heading = self._respond(log, delay, start, end, swarm)
        return step

    def heading_deviation(
        self, log: CommandLog, delay: float, start: float, end: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What a deviation of the heading at `start` [s] does until `end` [s], for c = 1.

        The derivative (1,) of the path [s] by the heading, complex, and the part of the deviation
        (1,) that is left (see `model.increments.heading_response`). With the commands of `log`,
        `delay` [s] late.
        """
        commands = log.since(start - self.model.delay - HEADING_MEMORY, delay)
        timeline = Timeline(commands, np.array([start, end]))
        one = ParticleParameters(np.zeros(1, int), np.ones(1), np.zeros(1))
        bent = heading_response(self.model, one, timeline)
        return bent.heading_sensitivity[0] @ [1, 1j], bent.heading_retention[0]

    def look_ahead(
        self, log: CommandLog, delay: float, start: float, end: float, swarm: Swarm,
    ) -> Step:
        """As `advance` from the last frame at `start` [s] to `end` [s]; the heading stays.

        Under the commands of `log` so far, `delay` [s] late, of a `swarm`.
        """
        return self._respond(log, delay, start, end, swarm)[0]

    def beyond_learned(self, log: CommandLog, delay: float, t: float,
                       swarm: Swarm) -> tuple[str, ...]:
        """Sentences on who of a `swarm` at `t` [s] is where a learned term knows nothing.

        Under the commands of `log`, `delay` [s] late.
        """
        if not self.model.learned:
            return ()
        found = beyond_learned(self.model, self._timeline(log, delay, t, t + 1e-6, swarm))
        return tuple(
            f'particle {", ".join(map(str, swarm.ids[np.broadcast_to(out[0], swarm.ids.shape)]))} '
            f'is outside the range where a term was learned against {against}: the term fades '
            'there'
            for against, out in found.items() if out.any() and len(swarm.ids))

    def _timeline(self, log: CommandLog, delay: float, start: float, end: float,
                  swarm: Swarm) -> Timeline:
        vectors = as_vectors(swarm.position)
        # How long a command has stayed takes a look back.
        memory = HEADING_MEMORY if self.model.learned else 0.0
        return Timeline(
            log.since(start - self.model.delay - memory, delay), np.array([start, end]),
            np.broadcast_to(vectors, (2, *vectors.shape)), swarm.ids,
            np.angle(swarm.velocity_phasor))

    def _respond(
        self, log: CommandLog, delay: float, start: float, end: float, swarm: Swarm,
    ) -> tuple[Step, np.ndarray]:
        if self.model.is_first_order:
            path, heading = integrate_direction(
                log.rows, delay, np.array([start, end]), self.heading[0],
                self.model.propulsion == 'rolling')
            return Step(path, _NO_DRIFT, end - start), heading[1:]
        timeline = self._timeline(log, delay, start, end, swarm)
        # A heading common to all is carried on; one of each, or none yet, follows from commands.
        known = self.heading.size == 1 and self.heading[0] != 0
        response = respond(self.model, timeline, self.heading if known else None)
        moved = response.drift[0, :, 0] + 1j * response.drift[0, :, 1]
        return Step(response.propulsion[0], moved, end - start), response.heading[1]
