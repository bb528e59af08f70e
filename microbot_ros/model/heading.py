"""Stage 2 over time: where every particle heads, at once or with lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.model import Model
from microbot_ros.model.scene import Scene
from microbot_ros.model.timeline import Segments, Timeline


@dataclass(frozen=True)
class Course:
    """The heading less φ, χ = θ − φ, through S spans; n is 1 where all particles share it.

    `heading` (S + 1, n): e^{iχ} at the edges, zero where the heading is not defined yet; `path`
    (S, n) [s]: ∫e^{iχ} dt over each span; `bend` (S, n) [s]: its derivative with respect to χ at
    the start of the span; `kept` (S, n): the derivative of χ at its end with respect to that.
    """

    heading: np.ndarray
    path: np.ndarray
    bend: np.ndarray
    kept: np.ndarray

    def after(self, lead: int) -> Course:
        """The course without its first `lead` spans."""
        return Course(*(a[lead:] for a in (self.heading, self.path, self.bend, self.kept)))


def follow(model: Model, timeline: Timeline, start: np.ndarray | None = None,
           ) -> tuple[Segments, Course, Scene]:
    """The spans of a timeline, the course from the first frame on, and its scene.

    `start` (N,) is e^{iχ} at the first frame; without it the history of commands decides.
    """
    segments = timeline.segments(model)
    scene = segments.scene(model)
    inside = scene.after(segments.lead, timeline.places(model))
    if start is not None:
        return segments, course(model, inside, start), inside
    return segments, course(model, scene).after(segments.lead), inside


def course(model: Model, scene: Scene, start: np.ndarray | None = None) -> Course:
    """Follow the heading through consecutive spans of constant field.

    `scene` has S spans; `start` (n,) is e^{iχ} when they begin. Without it the heading begins
    with the first field that is not zero, aligned to it, and is undefined before. Where the field
    is zero it stays.
    """
    target, driven = _target(model, scene)
    rate = model.alignment_rate(scene)
    if rate is not None:
        from microbot_ros.model.alignment_kernel import turn

        begin = np.zeros(1, complex) if start is None else np.asarray(start, dtype=complex)
        shape = np.broadcast_shapes(target.shape, rate.shape, (1, len(begin)))
        return Course(*turn(
            np.broadcast_to(begin, shape[1:]), np.broadcast_to(target, shape),
            np.broadcast_to(rate, shape), scene.span[:, 0],
        ))
    kept = np.zeros(target.shape)
    if not driven.all():
        target = _hold(target, driven, start)
        kept = np.where(driven | (target == 0), 0.0, 1.0)
    path = target * scene.span
    heading = np.concatenate([target, target[-1:]])
    return Course(heading, path, 1j * path * kept, kept)


def as_complex(vectors: np.ndarray) -> np.ndarray:
    """Real vectors (..., 2) as complex numbers (...), the inverse of `increments.as_vectors`."""
    return np.ascontiguousarray(vectors).view(complex)[..., 0]


def _target(model: Model, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """e^{iχ} that the field asks for (S, n), zero without a field, and whether there is one."""
    field = as_complex(scene.field)
    strength = np.abs(field)
    driven = strength > 0
    target = field / np.where(driven, strength, 1.0)
    return target * np.exp(1j * model.heading_offset(scene)), driven


def _hold(target: np.ndarray, driven: np.ndarray, start: np.ndarray | None) -> np.ndarray:
    """The target with each span without a field taking over the last heading before it."""
    before = np.zeros((1, 1)) if start is None else np.asarray(start)[None]
    shape = (len(target), max(before.shape[1], target.shape[1]))
    known = np.concatenate([np.broadcast_to(before, (1, shape[1])),
                            np.broadcast_to(target, shape)])
    last = np.maximum.accumulate(np.where(driven[:, 0], np.arange(1, len(known)), 0))
    return known[last]
