"""Candidate terms: covariate, frame, acted-on quantity, and knots where data are."""

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
"""Smallest distance of knots in time [s].

Choice: a table of a usual recording then has at most MOST knots; faster changes are not resolved.
"""

MOST = 120
"""Maximum number of knots on one axis.

Choice: time and memory grow with its square.
"""

LEVELS = 12
"""Number of distinct field strengths or frequencies up to which each has its own knot.

Choice: step protocols have fewer; a sweep gets evenly spaced knots.
"""

CELLS = 12
"""Knots along the longer side of the area that the particles covered.

Choice: up to 225 knots of place; a finer grid has few data per cell and costs time.
"""

TURN = 24
"""Knots around a full turn: 15° apart. Choice: the finest kernel (`curve.TURNS`) is wider."""

FADES = 0.1
"""Fraction of a range beyond its ends over which a term fades to zero.

Choice: prediction slightly outside the data is smooth, and none is made far outside.
"""

_PLAIN: tuple[Against, ...] = (
    'position', 'time', 'time since switch', 'command angle', 'heading', 'field strength',
    'frequency')
"""Covariates of one particle."""

_HEADING: tuple[ActsOn, ...] = ('speed', 'heading')
"""What a term in the frame of the heading acts on."""

_RADIAL: tuple[ActsOn, ...] = ('velocity', 'speed')
"""What a term in the frame of neighbours acts on."""


def candidates(fit: ModelFit) -> list[LearnedTerm]:
    """Return an empty table for each covariate and frame that the sessions can show.

    Covariates that do not vary are left out. With one particle, a velocity per particle in the
    laboratory is left out too: it would be a drift.

    Parameters
    ----------
    fit : ModelFit
        Fit whose residuals are searched.

    Returns
    -------
    list of LearnedTerm
        Tables of zeros; `seen` marks knots with data.
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


# Covariates of the data -------------------------------------------------------------------------

def _values(fit: ModelFit, against: Against) -> np.ndarray:
    """Return all values (M,) of a covariate in the used frames of a `fit`; M may be 0."""
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
    """Add a term of zeros to a model, so that the covariate of the term is computed.

    Parameters
    ----------
    model : Model
        Any model.
    against : Against
        The covariate.

    Returns
    -------
    Model
        Model of the same predictions.
    """
    axis = np.array([0.0, 1.0])
    axes = (axis, axis) if against == 'position' else (axis,)
    nothing = np.zeros((4 if against == 'position' else 2, 1))
    probe = LearnedTerm(against, 'heading', 'speed', axes, nothing, nothing, nothing,
                        np.zeros(len(nothing), bool))
    return replace(model, learned=(*model.learned, probe))


def spans(model: Model, against: Against,
          p: SessionFit) -> tuple[Segments, Course, EffectContext]:
    """Integrate the headings of a session with the covariate of a term.

    Parameters
    ----------
    model : Model
        Model of the session.
    against : Against
        The covariate.
    p : SessionFit
        Fit of the session.

    Returns
    -------
    segments : Segments
        Intervals between frames, split where commands change.
    course : Course
        Path and heading in each segment.
    context : EffectContext
        What effects and terms depend on, in each segment.
    """
    return integrate_heading(probed(model, against), p.session.timeline)


def _axes(against: Against, values: np.ndarray) -> tuple[np.ndarray, ...] | None:
    """Return knots over the `values` and a little beyond; None where they hardly vary."""
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
    """Return knots of square cells over the area that particles covered, and one around it."""
    low, high = (np.array([f(z.real), f(z.imag)]) for f in (np.min, np.max))
    cell = float((high - low).max()) / (CELLS - 1)
    if not cell > 0:
        return None
    count = np.maximum(np.ceil((high - low) / cell - 1e-9).astype(int), 1) + 3
    middle = (low + high) / 2
    return tuple(m + cell * (np.arange(n) - (n - 1) / 2)
                 for m, n in zip(middle, count, strict=True))


# Displacement by knots --------------------------------------------------------------------------

def steps(fit: ModelFit, p: SessionFit, term: LearnedTerm) -> Iterator[csr_array]:
    """Return the displacement by a unit value of each knot, in each frame interval.

    Computed at v and φ of the fit. Most knots displace nothing in an interval, so arrays are
    sparse.

    Parameters
    ----------
    fit : ModelFit
        Fit whose model the term joins.
    p : SessionFit
        One session of the fit.
    term : LearnedTerm
        Table with K knots and C components.

    Yields
    ------
    csr_array of complex, shape (T − 1, K·C)
        Displacements [m] of one track per unit value; knots of the first component come first.
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
    """Return the cumulative displacement since the first frame.

    Parameters
    ----------
    moved : csr_array of complex, shape (T − 1, M)
        Displacements in each frame interval [m].

    Returns
    -------
    ndarray of complex, shape (T, M)
        Displacements since the first frame [m].
    """
    way: np.ndarray = np.concatenate([np.zeros((1, moved.shape[1]), complex), moved.toarray()])
    for k in range(1, len(way)):  # of long rows six times as fast as cumsum
        way[k] += way[k - 1]
    return way
