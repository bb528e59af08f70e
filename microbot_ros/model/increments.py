"""Displacements of a model in each frame interval, which fits compare with data."""

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
    """Displacements in each of T − 1 frame intervals, for any v and φ.

    A particle with c = v e^{iφ} moves by c · `propulsion` + `drift`. Both are true displacements;
    `model.observe` converts them to measured ones.

    Attributes
    ----------
    model : Model
        The model.
    propulsion : ndarray of complex, shape (T − 1, 1 or N)
        Displacement per unit c [s], for rollers [s·Hz].
    drift : ndarray, shape (T − 1, 1 or N, 2)
        Displacement by drift [m].
    heading : ndarray of complex, shape (T, 1 or N)
        e^{i(θ−φ)} at the frames; 0 where it is not defined yet.
    """

    model: Model
    propulsion: np.ndarray
    drift: np.ndarray
    heading: np.ndarray

    def increments(self, particles: ParticleParameters) -> np.ndarray:
        """Return measured displacements.

        Parameters
        ----------
        particles : ParticleParameters
            N particles.

        Returns
        -------
        ndarray, shape (T − 1, N, 2)
            Displacements [m]; NaN only where a particle's own place is.
        """
        moved = as_vectors(particles.velocity_phasor * self.propulsion)
        moved += self.drift
        return self.model.observe(moved)

    def columns(self) -> np.ndarray:
        """Return the derivatives of measured displacements by v cos φ and v sin φ.

        With a = v cos φ and b = v sin φ the increments are `columns() @ (a, b) + offset()`.

        Returns
        -------
        ndarray, shape (T − 1, 1 or N, 2, 2)
            Derivatives [s]; last axes (xy, ab).
        """
        along = np.stack([as_vectors(self.propulsion), as_vectors(1j * self.propulsion)], axis=-2)
        return np.swapaxes(self.model.observe(along), -1, -2)

    def offset(self) -> np.ndarray:
        """Return the measured displacements that do not depend on v and φ.

        Returns
        -------
        ndarray, shape (T − 1, 1 or N, 2)
            Displacements [m].
        """
        return self.model.observe(self.drift)


def respond(model: Model, timeline: Timeline, start: np.ndarray | None = None) -> Response:
    """Return the response of a model on a timeline, exact for piecewise constant commands.

    Command changes within a frame interval, delays and a lagging heading are integrated in closed
    form. Effects that depend on position are evaluated at the timeline's positions.

    Parameters
    ----------
    model : Model
        The model.
    timeline : Timeline
        Commands and frames.
    start : ndarray of complex, shape (N,), optional
        e^{i(θ−φ)} at the first frame; by default it follows from the commands.

    Returns
    -------
    Response
        Displacements in each frame interval.
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
    """Return the displacements by one effect's drift (T − 1, 1 or N, 2) [m]."""
    drift = effect.drift(context)
    if drift is None:
        return np.zeros((len(segments.first), 1, 2))
    return segments.sum(drift * context.span[..., None])


def _directly(model: Model, timeline: Timeline, start: complex) -> Response:
    """Return the response without any effect, in a fraction of the time."""
    from microbot_ros.model.physics.alignment_kernel import integrate_direction

    commands, times = timeline.commands, timeline.times
    turns = np.zeros(len(commands.t)) if commands.frequency is None else commands.frequency
    path, heading = integrate_direction(
        np.column_stack([commands.t, commands.field, turns]), model.delay, times, start,
        model.propulsion == 'rolling')
    return Response(model, path[:, None], np.zeros((len(path), 1, 2)), heading[:, None])


def beyond_learned(model: Model, timeline: Timeline) -> dict[str, np.ndarray]:
    """Return which particles are where a learned term has no data, and has faded to zero.

    Parameters
    ----------
    model : Model
        The model.
    timeline : Timeline
        Commands and T frames.

    Returns
    -------
    dict of str to ndarray of bool, shape (T − 1, 1 or N)
        By covariate, in each frame interval.
    """
    if not model.learned:
        return {}
    segments, _, context = integrate_heading(model, timeline)
    return {term.against: segments.sum((~term.inside(context)).astype(int)) > 0
            for term in model.learned}


@dataclass(frozen=True)
class HeadingResponse:
    """Effect of a small rotation of the heading at a frame until the next.

    Attributes
    ----------
    theta : ndarray, shape (T, N)
        Heading at the frames [rad]; NaN where not defined yet.
    heading_sensitivity : ndarray, shape (T − 1, N, 2)
        Derivative of each measured increment by θ at its start [m/rad].
    heading_retention : ndarray, shape (T − 1, N)
        Fraction of the rotation that remains at the end of the interval: 0 for immediate
        alignment, 1 without a field.
    """

    theta: np.ndarray
    heading_sensitivity: np.ndarray
    heading_retention: np.ndarray


def heading_response(model: Model, particles: ParticleParameters,
                     timeline: Timeline) -> HeadingResponse:
    """Return headings at the frames, and the effect of noise in them.

    For a filter of positions whose state includes the heading.

    Parameters
    ----------
    model : Model
        The model.
    particles : ParticleParameters
        N particles.
    timeline : Timeline
        Commands and T frames.

    Returns
    -------
    HeadingResponse
        Headings, sensitivities and retentions.
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
