"""Effects of one fit that take each other back."""

from __future__ import annotations

import numpy as np

from microbot_ros.discovery.evidence import levels
from microbot_ros.discovery.likelihood import Fit, Part, eliminate, inner
from microbot_ros.model.model import Model

TAKEN_BACK = -np.sqrt(0.5)
"""Cosine below which at least half of what one effect does is undone by the other."""


def taken_back(fit: Fit, name: str) -> bool:
    """Whether another field of place undoes most of what this one does.

    A spot and a flow that nearly cancel are a series for some third field. What is compared are
    the white displacements that each causes, less what v, φ and offsets absorb.
    """
    fields = [effect.id for effect in fit.model.effects if effect.needs_position]
    if name not in fields or len(fields) < 2:
        return False
    overlap = sum(_overlap(p, fit.model, fields) for p in fit.parts)
    size = np.sqrt(np.maximum(np.diagonal(overlap), 1e-300))
    cosine = (overlap / np.outer(size, size))[fields.index(name)]
    return bool(cosine.min() < TAKEN_BACK)


def _overlap(p: Part, model: Model, names: list[str]) -> np.ndarray:
    """Inner products (E, E) of what these effects do in one session."""
    moved = p.levels.moved(p.swim)
    columns = [np.broadcast_to(moved - levels(model.without(name), p.evidence).moved(p.swim),
                               p.evidence.z.shape) for name in names]
    white = p.whiten(np.stack(columns, axis=-1))
    both = np.concatenate([p.white / np.sqrt(p.diffusion), white], axis=-1)
    return eliminate(inner(both, p.evidence)).sum(axis=0)[1:, 1:]
