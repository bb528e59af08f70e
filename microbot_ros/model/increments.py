"""What a model says of every frame interval: the displacements that fits compare with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.heading import integrate_heading
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.vectors import as_vectors
from microbot_ros.model.timeline import Segments, Timeline


@dataclass(frozen=True)
class Response:
    """Displacements over each of T−1 frame intervals, before the particles' v and φ are known.

    A particle with c = v e^{iφ} moves by c · `propulsion` + `drift`. `propulsion` (T−1, 1 or N)
    complex [s], for rolling particles [s·Hz]; `drift` (T−1, 1 or N, 2) [m]; both are true
    displacements, `model.observe` makes them measured. `heading` (T, 1 or N): e^{i(θ−φ)} at the
    frames, zero where it is not defined yet.
    """

    model: Model
    propulsion: np.ndarray
    drift: np.ndarray
    heading: np.ndarray

    def increments(self, particles: ParticleParameters) -> np.ndarray:
        """Measured displacements (T−1, N, 2) [m]; NaN only where a particle's own place is."""
        moved = as_vectors(particles.velocity_phasor * self.propulsion)
        moved += self.drift
        return self.model.observe(moved)

    def columns(self) -> np.ndarray:
        """Derivatives (T−1, 1 or N, 2, 2) of the measured displacements; last axes (xy, ab).

        With a = v cos φ and b = v sin φ the increments are `columns() @ (a, b) + offset()`.
        """
        along = np.stack([as_vectors(self.propulsion), as_vectors(1j * self.propulsion)], axis=-2)
        return np.swapaxes(self.model.observe(along), -1, -2)

    def offset(self) -> np.ndarray:
        """The measured displacements (T−1, 1 or N, 2) [m] that do not depend on v and φ."""
        return self.model.observe(self.drift)


def respond(model: Model, timeline: Timeline, start: np.ndarray | None = None) -> Response:
    """The response of a model on a timeline: exact for commands that hold until the next.

    Switches inside a frame interval, delays and the turning of a lagging heading are integrated
    in closed form; terms that depend on position are taken at the timeline's positions. `start`
    (N,) is e^{i(θ−φ)} at the first frame; without it the heading follows from the commands.
    """
    if model.is_first_order and (start is None or len(start) == 1):
        return _directly(model, timeline, 0j if start is None else complex(start[0]))
    segments, course, context = integrate_heading(model, timeline, start)
    propulsion = segments.sum(course.path * model.speed_factor(context))
    moved = np.zeros((len(propulsion), 1, 2))
    for effect in model.drifts:
        moved = moved + timeline.part(
            (effect, model.answering('latency', 'field', 'observe')), model,
            partial(_drifted, effect, segments, context))
    for term in model.learned:
        moved = moved + _drifted(term, segments, context)
    return Response(model, propulsion, moved, course.heading[segments.frames])


def _drifted(effect: Effect | LearnedTerm, segments: Segments,
             context: EffectContext) -> np.ndarray:
    """What one effect drifts in every frame interval (T−1, 1 or N, 2) [m]."""
    drift = effect.drift(context)
    if drift is None:
        return np.zeros((len(segments.first), 1, 2))
    return segments.sum(drift * context.span[..., None])


def _directly(model: Model, timeline: Timeline, start: complex) -> Response:
    """The same where no effect acts, in a fraction of the time."""
    from microbot_ros.model.physics.alignment_kernel import integrate_direction

    commands, times = timeline.commands, timeline.times
    turns = np.zeros(len(commands.t)) if commands.frequency is None else commands.frequency
    path, heading = integrate_direction(
        np.column_stack([commands.t, commands.field, turns]), model.delay, times, start,
        model.propulsion == 'rolling')
    return Response(model, path[:, None], np.zeros((len(path), 1, 2)), heading[:, None])


def increments(model: Model, particles: ParticleParameters, timeline: Timeline) -> np.ndarray:
    """∫ velocity dt over each frame interval as the camera would report it: (T−1, N, 2) [m]."""
    return respond(model, timeline).increments(particles)


def beyond_learned(model: Model, timeline: Timeline) -> dict[str, np.ndarray]:
    """Which particles (T−1, 1 or N) are where no data were when a term of a `model` was learned.

    By covariate, in the frame intervals of a `timeline`: there the term fades to nothing.
    """
    if not model.learned:
        return {}
    segments, _, context = integrate_heading(model, timeline)
    return {term.against: segments.sum((~term.inside(context)).astype(int)) > 0
            for term in model.learned}


@dataclass(frozen=True)
class HeadingResponse:
    """How a small turn of the heading at a frame is felt until the next.

    `theta` (T, N) [rad], NaN where not defined yet; `heading_sensitivity` (T−1, N, 2) [m/rad]:
    the derivative of each measured increment with respect to θ at its start; `heading_retention`
    (T−1, N): the part of the turn that is left at its end, 0 where alignment is immediate, 1
    without a field.
    """

    theta: np.ndarray
    heading_sensitivity: np.ndarray
    heading_retention: np.ndarray


def heading_response(model: Model, particles: ParticleParameters,
                     timeline: Timeline) -> HeadingResponse:
    """The heading of `particles` at the frames of a `timeline`, and what noise in it does.

    For a filter of positions whose state holds the heading too.
    """
    from microbot_ros.model.physics.alignment_kernel import chain_intervals

    segments, course, context = integrate_heading(model, timeline)
    sensitivity = course.heading_sensitivity * model.speed_factor(context)
    retention = np.broadcast_to(course.heading_retention, sensitivity.shape)
    sensitivity, retention = chain_intervals(segments.first, sensitivity, retention)
    at_frames = course.heading[segments.frames]
    theta = np.where(at_frames == 0, np.nan, np.angle(at_frames)) + particles.phi
    felt = model.observe(as_vectors(particles.velocity_phasor * sensitivity))
    return HeadingResponse(theta, felt, np.broadcast_to(retention, felt.shape[:2]))
