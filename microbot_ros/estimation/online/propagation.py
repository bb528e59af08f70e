"""Motion of particles from frame to frame, from the commands through the model."""

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
"""Time [s] of commands from which a lagging heading is integrated anew.

Choice: many alignment times; a longer one costs time in every frame.
"""
_NO_DRIFT = np.zeros(1, complex)
"""Drift of a first-order model."""


class Step(NamedTuple):
    """Displacement c·`path` + `drift` of particles in an interval, c = v e^{iφ}.

    Attributes
    ----------
    path : ndarray of complex, shape (1 or N,)
        Displacement per unit c [s].
    drift : ndarray of complex, shape (1 or N,)
        Displacement by drift [m].
    span : float
        Length of the interval [s].
    """

    path: np.ndarray
    drift: np.ndarray
    span: float


class Swarm(NamedTuple):
    """State of N particles.

    Attributes
    ----------
    ids : ndarray of int, shape (N,)
        Particles.
    position : ndarray of complex, shape (N,)
        Positions [m].
    velocity_phasor : ndarray of complex, shape (N,)
        v e^{iφ}.
    """

    ids: np.ndarray
    position: np.ndarray
    velocity_phasor: np.ndarray


class Propagator:
    """Exact integration of a model's response between frames, with memory of the heading.

    Parameters
    ----------
    model : Model
        The model.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.heading = np.zeros(1, complex)
        """e^{i(θ−φ)} (1 or N,) at the last frame; zero where no field has been yet."""

    def advance(
        self, log: CommandLog, delay: float, start: float, end: float, swarm: Swarm,
    ) -> Step:
        """Integrate to the next frame, with the heading.

        Parameters
        ----------
        log : CommandLog
            Commands.
        delay : float
            Delay of the commands [s].
        start, end : float
            Times of the last and the next frame [s].
        swarm : Swarm
            Particles at `start`.

        Returns
        -------
        Step
            The displacement.
        """
        step, self.heading = self._respond(log, delay, start, end, swarm)
        return step

    def heading_deviation(
        self, log: CommandLog, delay: float, start: float, end: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the effect of a deviation of the heading, for c = 1.

        See `model.increments.heading_response`.

        Parameters
        ----------
        log : CommandLog
            Commands.
        delay : float
            Delay of the commands [s].
        start, end : float
            Times of the last and the next frame [s].

        Returns
        -------
        sensitivity : ndarray of complex, shape (1,)
            Derivative of the path by the heading at `start` [s].
        retention : ndarray, shape (1,)
            Fraction of the deviation that remains at `end`.
        """
        commands = log.since(start - self.model.delay - HEADING_MEMORY, delay)
        timeline = Timeline(commands, np.array([start, end]))
        one = ParticleParameters(np.zeros(1, int), np.ones(1), np.zeros(1))
        bent = heading_response(self.model, one, timeline)
        return bent.heading_sensitivity[0] @ [1, 1j], bent.heading_retention[0]

    def look_ahead(
        self, log: CommandLog, delay: float, start: float, end: float, swarm: Swarm,
    ) -> Step:
        """Integrate as `advance` does, without changing the heading.

        Parameters
        ----------
        log : CommandLog
            Commands so far.
        delay : float
            Delay of the commands [s].
        start, end : float
            Time of the last frame, and time of the prediction [s].
        swarm : Swarm
            Particles at `start`.

        Returns
        -------
        Step
            The displacement.
        """
        return self._respond(log, delay, start, end, swarm)[0]

    def beyond_learned(self, log: CommandLog, delay: float, t: float,
                       swarm: Swarm) -> tuple[str, ...]:
        """Return sentences on particles where a learned term has no data.

        Parameters
        ----------
        log : CommandLog
            Commands.
        delay : float
            Delay of the commands [s].
        t : float
            Time [s].
        swarm : Swarm
            Particles at `t`.

        Returns
        -------
        tuple of str
            One for each term.
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
        # The time since a switch needs earlier commands.
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
        # A common heading is continued; separate or undefined ones follow from the commands.
        known = self.heading.size == 1 and self.heading[0] != 0
        response = respond(self.model, timeline, self.heading if known else None)
        moved = response.drift[0, :, 0] + 1j * response.drift[0, :, 1]
        return Step(response.propulsion[0], moved, end - start), response.heading[1]
