"""The first-order integrator: exact for commands that hold until the next."""

from __future__ import annotations

import numpy as np

from microbot_ros.model.heading import course
from microbot_ros.model.increments import as_vectors, respond
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.scene import Places, Scene
from microbot_ros.model.timeline import Timeline
from microbot_ros.records import Commands


def simulate(model: Model, particles: ParticleParameters, commands: Commands, times: np.ndarray,
             start: np.ndarray, heading: np.ndarray | None = None) -> np.ndarray:
    """True positions (T, N, 2) [m] at `times` (T,) [s] of particles that begin at `start` (N, 2).

    `heading` θ (N,) [rad] at the first time; without it, aligned to the field in force, or held
    from the last field before. Where no effect depends on position the result is exact and needs
    no steps: position = start + v e^{iφ} ∫e^{i(θ−φ)} dt + ∫drift dt. Otherwise a fourth-order
    Runge–Kutta step is made over each span of at most `timeline.LONGEST`, with the exact mean of
    the heading. Use `model.observe` for what a camera would report.
    """
    timeline = Timeline(commands, times)
    begin = None if heading is None else np.exp(1j * (np.asarray(heading) - particles.phi))
    if model.needs_position:
        return _step(model, particles, timeline, np.asarray(start, dtype=float), begin)
    response = respond(model, timeline, begin)
    position = np.empty((len(times), len(particles.ids), 2))
    position[0] = start
    moved = position[1:].view(complex)[..., 0]
    np.multiply(np.cumsum(response.propulsion, axis=0), particles.velocity, out=moved)
    position[1:] += np.asarray(start) + np.cumsum(response.drift, axis=0)
    return position


def _step(model: Model, particles: ParticleParameters, timeline: Timeline, start: np.ndarray,
          begin: np.ndarray | None) -> np.ndarray:
    segments = timeline.segments(model)
    scene = segments.scene(model)
    lead = segments.lead
    if begin is not None:
        scene, lead = scene.after(lead), 0
    way = course(model, scene, begin)
    scene = scene.after(lead)
    mean = particles.velocity * (way.path[lead:] / scene.span)
    position = np.empty((len(timeline.times), *start.shape))
    position[0] = p = start
    last = np.append(segments.first[1:], len(mean)) - 1
    frame = 1
    for k, h in enumerate(scene.span[:, 0].tolist()):
        def velocity(at: np.ndarray, k: int = k) -> np.ndarray:
            return _velocity(model, scene.at(k, Places(at)), mean[k])

        k1 = velocity(p)
        k2 = velocity(p + h / 2 * k1)
        k3 = velocity(p + h / 2 * k2)
        k4 = velocity(p + h * k3)
        p = p + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if k == last[frame - 1]:
            position[frame] = p
            frame += 1
    return position


def _velocity(model: Model, scene: Scene, propulsion: np.ndarray) -> np.ndarray:
    """dp/dt (N, 2) in a scene under a propulsion (N,) before the speed's factors."""
    velocity = as_vectors(propulsion * model.speed_factor(scene))
    drift = model.drift(scene)
    return velocity if drift is None else velocity + drift
