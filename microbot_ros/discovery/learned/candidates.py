"""What a term may be drawn against, in which frame and on what it acts: its knots in the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from microbot_ros.estimation.likelihood.joint import SessionFit
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.heading import Course, integrate_heading
from microbot_ros.model.learned_term import (
    PERIODIC,
    ActsOn,
    Against,
    Frame,
    LearnedTerm,
    coordinate,
)
from microbot_ros.model.model import Model
from microbot_ros.model.physics.vectors import as_complex, as_vectors
from microbot_ros.model.timeline import Segments

if TYPE_CHECKING:
    from scipy.sparse import csr_array

FINEST = 0.4
"""Seconds between knots in time, at least: what is faster has no room in a table."""

MOST = 120
"""Knots of one axis, at most."""

LEVELS = 12
"""Different values of a field's strength or frequency up to which each has its own knot."""

CELLS = 12
"""Knots along the longer side of where the particles were."""

TURN = 24
"""Knots around a turn."""

FADES = 0.1
"""Part of a range beyond its ends over which a term fades to nothing."""

_PLAIN: tuple[Against, ...] = (
    'position', 'time', 'time since switch', 'command angle', 'heading', 'field strength',
    'frequency')
_HEADING: tuple[ActsOn, ...] = ('speed', 'heading')
_RADIAL: tuple[ActsOn, ...] = ('velocity', 'speed')


def candidates(fit: ModelFit) -> list[LearnedTerm]:
    """Every pair of covariate and frame that the sessions of a `fit` can show, as empty tables.

    Without a covariate that never changes, and in the laboratory without particles where there is
    but one: that is a drift.
    """
    pairs: list[tuple[Against, Frame, ActsOn]] = [
        (against, 'laboratory', 'velocity') for against in (*_PLAIN, 'particle')]
    pairs += [(against, 'heading', acts) for against in _PLAIN for acts in _HEADING]
    pairs += [('neighbour distance', 'radial', acts) for acts in _RADIAL]
    seen = {against: _values(fit, against) for against in dict.fromkeys(one for one, *_ in pairs)}
    return [_empty(*pair, axes, values) for pair in pairs
            if (values := seen[pair[0]]).size and (axes := _axes(pair[0], values))]


def _empty(against: Against, frame: Frame, acts_on: ActsOn, axes: tuple[np.ndarray, ...],
           values: np.ndarray) -> LearnedTerm:
    count = int(np.prod([len(axis) for axis in axes]))
    nothing = np.zeros((count, 2 if acts_on == 'velocity' else 1))
    term = LearnedTerm(against, frame, acts_on, axes, nothing, nothing, nothing,
                       np.zeros(count, bool))
    where, weight = term._corners(values)
    held = np.bincount(where.ravel(), weight.ravel(), minlength=count)
    return replace(term, seen=held > 0.5)


# What was looked at -----------------------------------------------------------------------------

def _values(fit: ModelFit, against: Against) -> np.ndarray:
    """All values (M,) of a covariate in the used frames of a `fit`; M may be 0."""
    found = []
    for p in fit.session_fits:
        if against in ('neighbour distance', 'particle') and len(p.session.ids) < 2:
            continue
        if against == 'frequency' and p.session.commands.frequency is None:
            continue
        _, _, context = spans(fit.model, against, p)
        if against == 'neighbour distance':
            z = as_complex(context.position)
            apart = np.abs(z[:, :, None] - z[:, None, :])
            found.append(apart[np.isfinite(apart) & (apart > 0)])
            continue
        shape = (len(context.t), len(p.session.ids))
        interval = p.session.timeline.segments(probed(fit.model, against)).interval
        used = p.session.joined()[interval]
        values = np.broadcast_to(coordinate(against, context), shape)[used]
        found.append(values[np.isfinite(values)])
    return np.concatenate(found) if found else np.empty(0)


def probed(model: Model, against: Against) -> Model:
    """A `model` that looks at a covariate, `against` which a term may be drawn, idly."""
    axis = np.array([0.0, 1.0])
    axes = (axis, axis) if against == 'position' else (axis,)
    nothing = np.zeros((4 if against == 'position' else 2, 1))
    probe = LearnedTerm(against, 'heading', 'speed', axes, nothing, nothing, nothing,
                        np.zeros(len(nothing), bool))
    return replace(model, learned=(*model.learned, probe))


def spans(model: Model, against: Against,
          p: SessionFit) -> tuple[Segments, Course, EffectContext]:
    """The spans of `p`, a session, under a `model` that looks at the covariate `against` which a
    term is drawn: with course and context.
    """
    return integrate_heading(probed(model, against), p.session.timeline)


def _axes(against: Against, values: np.ndarray) -> tuple[np.ndarray, ...] | None:
    """Knots over the `values` and a little beyond; None where they don't vary enough."""
    if against == 'position':
        return _grid(values)
    if against in PERIODIC:
        spread = np.abs(np.exp(1j * values).mean())
        return None if spread > 0.9999 else (-np.pi + np.arange(TURN) * 2 * np.pi / TURN,)
    if against == 'particle':
        return (np.unique(values).astype(float),)
    levels = np.unique(np.round(values, 12))
    if len(levels) < 2:
        return None
    low, high = levels[0], levels[-1]
    if against in ('field strength', 'frequency') and len(levels) <= LEVELS:
        inside = levels
    elif against == 'neighbour distance':
        inside = np.geomspace(low, max(np.quantile(values, 0.9), 1.5 * low), 24)
    elif against == 'time since switch':
        high = np.quantile(values, 0.99)
        inside = low + (high - low) * np.linspace(0, 1, 24) ** 1.5
    else:
        count = MOST if against != 'time' else int(np.clip((high - low) / FINEST, 8, MOST))
        inside = np.linspace(low, high, count if against == 'time' else 24)
    fade = FADES * (inside[-1] - inside[0])
    return (np.concatenate([[inside[0] - fade], inside, [inside[-1] + fade]]),)


def _grid(z: np.ndarray) -> tuple[np.ndarray, ...] | None:
    """Square cells over where particles were, and one around."""
    low, high = (np.array([f(z.real), f(z.imag)]) for f in (np.min, np.max))
    cell = float((high - low).max()) / (CELLS - 1)
    if not cell > 0:
        return None
    count = np.maximum(np.ceil((high - low) / cell - 1e-9).astype(int), 1) + 3
    middle = (low + high) / 2
    return tuple(m + cell * (np.arange(n) - (n - 1) / 2)
                 for m, n in zip(middle, count, strict=True))


# What each knot does ----------------------------------------------------------------------------

def steps(fit: ModelFit, p: SessionFit, term: LearnedTerm) -> Iterator[csr_array]:
    """What the value of every knot moves one track of a session in each frame interval [m].

    (T − 1, K·C) complex each, knots of the first component first: of most knots nothing. Of `p`,
    a session of a `fit`, at its v and φ.
    """
    from scipy.sparse import csr_array

    segments, course, context = spans(fit.model, term.against, p)
    where, weight = term.knots(context)
    driven = course.path * fit.model.speed_factor(context)
    count, components = term.values.shape
    for n, c in enumerate(p.velocity_phasor):
        knot, part = (one[:, min(n, one.shape[1] - 1)] for one in (where, weight))
        if term.acts_on == 'velocity':
            moved = np.concatenate([part, 1j * part], axis=1) * context.span
            knot = np.concatenate([knot, count + knot], axis=1)
        else:
            way = driven[:, min(n, driven.shape[1] - 1), None] * c
            moved = part * way * (1j if term.acts_on == 'heading' else 1.0)
        if fit.model.effects:
            moved = as_complex(fit.model.observe(as_vectors(moved)))
        yield csr_array(
            (np.nan_to_num(moved).ravel(), knot.ravel(), segments.frames * knot.shape[1]),
            shape=(len(segments.frames) - 1, count * components))


def accumulated(moved: csr_array) -> np.ndarray:
    """Displacements (T, M) [m] since the first frame by what is `moved` (T − 1, M) from then on.
    """
    return np.concatenate([np.zeros((1, moved.shape[1]), complex), moved.toarray().cumsum(axis=0)])
