"""Stage 2 over time: the heading of every particle, immediate or with lag."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.model import Model
from microbot_ros.model.physics.vectors import as_complex
from microbot_ros.model.timeline import Segments, Timeline


@dataclass(frozen=True)
class Course:
    """Heading less φ, χ = θ − φ, in S spans; n is 1 if all particles share it.

    Attributes
    ----------
    heading : ndarray of complex, shape (S + 1, n)
        e^{iχ} at the edges; 0 where the heading is not defined yet.
    path : ndarray of complex, shape (S, n)
        ∫e^{iχ} dt over each span [s].
    heading_sensitivity : ndarray of complex, shape (S, n)
        Derivative of `path` by χ at the start of the span [s].
    heading_retention : ndarray, shape (S, n)
        Derivative of χ at the end of the span by χ at its start.
    """

    heading: np.ndarray
    path: np.ndarray
    heading_sensitivity: np.ndarray
    heading_retention: np.ndarray

    def after(self, lead: int) -> Course:
        """Return the course without its first spans.

        Parameters
        ----------
        lead : int
            Number of spans that are removed.

        Returns
        -------
        Course
            The later spans.
        """
        return Course(*(getattr(self, field.name)[lead:] for field in fields(self)))


def integrate_heading(
    model: Model, timeline: Timeline, start: np.ndarray | None = None,
) -> tuple[Segments, Course, EffectContext]:
    """Integrate the heading under a model from the first frame on.

    Parameters
    ----------
    model : Model
        The model.
    timeline : Timeline
        Commands and frames.
    start : ndarray of complex, shape (N,), optional
        e^{iχ} at the first frame; by default the earlier commands determine it.

    Returns
    -------
    segments : Segments
        Spans of the timeline.
    course : Course
        Heading in each span.
    context : EffectContext
        What effects depend on in each span.
    """
    segments = timeline.segments(model)
    context = segments.context(model)
    inside = context.after(segments.lead, timeline.places(model))
    if start is not None:
        return segments, heading_course(model, inside, start), inside
    if model.turns_by_place and inside.places is not None:
        context = context.after(0, inside.places.led_by(segments.lead))
    course = timeline.part(
        (model.answering('latency', 'field', 'heading_offset', 'alignment_rate'),
         tuple(term for term in model.learned if term.acts_on == 'heading')), model,
        lambda: heading_course(model, context).after(segments.lead))
    return segments, course, inside


def heading_course(
    model: Model, context: EffectContext, start: np.ndarray | None = None,
) -> Course:
    """Integrate the heading through consecutive spans of constant field.

    Without a field the heading stays.

    Parameters
    ----------
    model : Model
        The model.
    context : EffectContext
        S spans.
    start : ndarray of complex, shape (n,), optional
        e^{iχ} at the start. By default the heading begins aligned to the first field that is not
        zero, and is undefined before.

    Returns
    -------
    Course
        Heading in each span.
    """
    target, driven = _target(model, context)
    rate = model.alignment_rate(context)
    if rate is not None:
        from microbot_ros.model.physics.alignment_kernel import integrate_alignment

        begin = np.zeros(1, complex) if start is None else np.asarray(start, dtype=complex)
        shape = np.broadcast_shapes(target.shape, rate.shape, (1, len(begin)))
        return Course(*integrate_alignment(
            np.broadcast_to(begin, shape[1:]), np.broadcast_to(target, shape),
            np.broadcast_to(rate, shape), context.span[:, 0],
        ))
    retention = np.zeros(target.shape)
    if not driven.all():
        target = _hold(target, driven, start)
        retention = np.where(driven | (target == 0), 0.0, 1.0)
    path = target * context.span
    heading = np.concatenate([target, target[-1:]])
    return Course(heading, path, 1j * path * retention, retention)


def _target(model: Model, context: EffectContext) -> tuple[np.ndarray, np.ndarray]:
    """Return e^{iχ} that the field demands (S, n), 0 without a field, and whether there is one."""
    field = as_complex(context.field)
    strength = np.abs(field)
    driven = strength > 0
    target = field / np.where(driven, strength, 1.0)
    return target * np.exp(1j * model.heading_offset(context)), driven


def _hold(target: np.ndarray, driven: np.ndarray, start: np.ndarray | None) -> np.ndarray:
    """Return the target with spans without a field filled by the last heading before."""
    before = np.zeros((1, 1)) if start is None else np.asarray(start)[None]
    shape = (len(target), max(before.shape[1], target.shape[1]))
    known = np.concatenate([np.broadcast_to(before, (1, shape[1])),
                            np.broadcast_to(target, shape)])
    last = np.maximum.accumulate(np.where(driven[:, 0], np.arange(1, len(known)), 0))
    return known[last]
