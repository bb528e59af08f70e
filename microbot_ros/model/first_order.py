"""First-order integrator: exact for piecewise constant commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.heading import integrate_heading
from microbot_ros.model.increments import Response, respond
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.vectors import as_complex, as_vectors
from microbot_ros.model.timeline import Timeline


def simulate(model: Model, particles: ParticleParameters, commands: Commands, times: np.ndarray,
             start: np.ndarray, heading: np.ndarray | None = None) -> np.ndarray:
    """Simulate true positions of particles.

    Without effects that depend on position the result is exact and needs no steps: position =
    start + v e^{iφ} ∫e^{i(θ−φ)} dt + ∫drift dt. Otherwise a fourth-order Runge–Kutta step is made
    over each span of at most `timeline.LONGEST`, with the exact mean of the heading. Use
    `model.observe` for what a camera would report.

    Parameters
    ----------
    model : Model
        The model.
    particles : ParticleParameters
        N particles.
    commands : Commands
        Commands.
    times : ndarray, shape (T,)
        Times [s], ascending.
    start : ndarray, shape (N, 2)
        Positions at the first time [m].
    heading : ndarray, shape (N,), optional
        θ at the first time [rad]; by default aligned to the field in force, or held from the last
        field before.

    Returns
    -------
    ndarray, shape (T, N, 2)
        Positions [m].
    """
    timeline = Timeline(commands, times)
    begin = None if heading is None else np.exp(1j * (np.asarray(heading) - particles.phi))
    if model.needs_position:
        return _step(model, particles, timeline, np.asarray(start, dtype=float), begin)
    response = respond(model, timeline, begin)
    if response.propulsion.shape[1] == 1:
        return _spread(response, particles.velocity_phasor, np.asarray(start, dtype=float))
    moved = as_vectors(particles.velocity_phasor * response.propulsion) + response.drift
    return np.concatenate([[start], start + np.cumsum(moved, axis=0)])


def _spread(response: Response, velocity: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return all trajectories of particles that share one course and one drift.

    As complex numbers, positions are the path @ (velocity, 1, start). With real and imaginary
    parts of the path as columns, one product of real matrices writes every position once.
    """
    path = np.zeros((len(response.propulsion) + 1, 3), dtype=complex)
    np.cumsum(response.propulsion[:, 0], out=path[1:, 0])
    np.cumsum(as_complex(response.drift)[:, 0], out=path[1:, 1])
    path[:, 2] = 1.0
    weights = np.zeros((6, *start.shape))
    weights[0] = as_vectors(velocity)
    weights[1] = as_vectors(1j * velocity)
    weights[2, :, 0] = weights[3, :, 1] = 1.0
    weights[4] = start
    return (path.view(float) @ weights.reshape(6, -1)).reshape(-1, *start.shape)


def _step(model: Model, particles: ParticleParameters, timeline: Timeline, start: np.ndarray,
          begin: np.ndarray | None) -> np.ndarray:
    # Terms that turn headings by place are evaluated at every step.
    local = tuple(one for one in model.learned if one.needs_position and one.acts_on == 'heading')
    rest = replace(model, learned=tuple(one for one in model.learned if one not in local))
    segments, course, context = integrate_heading(rest, timeline, begin)
    mean = particles.velocity_phasor * (course.path / context.span)
    position = np.empty((len(timeline.times), *start.shape))
    position[0] = p = start
    last = segments.frames[1:] - 1
    frame = 1
    for k, h in enumerate(context.span[:, 0].tolist()):
        def velocity(at: np.ndarray, k: int = k) -> np.ndarray:
            there = context.at(k, Places(at, particles.ids, particles.phi))
            turned = sum(one.heading_offset(there) for one in local)
            return _velocity(model, there, mean[k] * np.exp(1j * turned))

        k1 = velocity(p)
        k2 = velocity(p + h / 2 * k1)
        k3 = velocity(p + h / 2 * k2)
        k4 = velocity(p + h * k3)
        p = p + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if k == last[frame - 1]:
            position[frame] = p
            frame += 1
    return position


def _velocity(model: Model, context: EffectContext, propulsion: np.ndarray) -> np.ndarray:
    """Return dp/dt (N, 2) under a propulsion (N,) before the factors on speed."""
    velocity = as_vectors(propulsion * model.speed_factor(context))
    drift = model.drift(context)
    return velocity if drift is None else velocity + drift
