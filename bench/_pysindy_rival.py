"""PySINDy on the same sessions, given the features of our library by hand.

Sparse regression of velocities (STLSQ) on the baseline's motion m and on what the effects of the
library would add to it, linearised; the threshold chosen by cross-validation over blocks of
time, as nobody can know it beforehand. It names what keeps a coefficient.
"""

from __future__ import annotations

import warnings

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.model.increments import as_vectors, respond
from microbot_ros.model.model import Model
from microbot_ros.model.timeline import Timeline

THRESHOLDS = np.geomspace(3e-3, 1.0, 9)
BLOCKS = 4
SPEAKS_OF = ('heading_slip', 'uniform_drift', 'linear_flow', 'speed_decay', 'alignment_lag',
             'hydrodynamic_slowdown', 'gradient_force', 'incomplete_alignment')
"""Effects of the features, two columns each: right and up."""


def named(session: Session) -> set[str]:
    """The effects that the features it keeps beside the baseline's motion speak of."""
    velocity, features = _regression(session)
    folds = np.arange(len(velocity[0])) * BLOCKS // len(velocity[0])
    errors = [
        sum(_error(velocity, features, folds == k, threshold) for k in range(BLOCKS))
        for threshold in THRESHOLDS
    ]
    best = THRESHOLDS[int(np.argmin(errors))]
    beside = _fit(velocity, features, np.ones(len(folds), bool), best)
    beside[0, 0] = beside[1, 1] = 0.0
    return {SPEAKS_OF[column // 2] for column in np.flatnonzero((beside != 0).any(axis=0))}


def _regression(session: Session) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Per particle velocities (T−1, 2) and features (T−1, F), both divided by their scale.

    Over gaps nothing is known: rows with a neighbour missing are NaN and left out of fits.
    """
    times, seen = session.tracks.grid()
    began = times >= session.commands.t[0]
    times, seen = times[began], seen[began]
    model = Model.baseline(session.conditions, session.commands)
    response = respond(model, Timeline(session.commands, times)).propulsion
    h = np.diff(times)[:, None]
    late = respond(model, Timeline(session.commands, times - 0.1)).propulsion
    z = seen[..., 0] + 1j * seen[..., 1]
    moved = np.diff(z, axis=0) / h
    field = np.hypot(*session.commands.field_at(times[:-1]).T)[:, None]
    velocities, features = [], []
    for i in range(z.shape[1]):
        known = np.isfinite(moved[:, i])
        u, v = response[:, 0] / h[:, 0], moved[:, i]
        swim = (np.conj(u[known]) @ v[known]) / max((np.abs(u[known]) ** 2).sum(), 1e-30)
        own, place = swim * u, z[:-1, i] * 1e6
        lagged = swim * (late[:, 0] / h[:, 0] - u)
        near = np.nansum(1 / np.abs(np.delete(z[:-1] - z[:-1, [i]], i, axis=1)), axis=1) / 1e6
        columns = [
            own, np.ones_like(own) * np.abs(swim), place, own * times[:-1], lagged,
            own * near, place * field[:, 0] / field.max(), own * field[:, 0] / field.max(),
        ]
        scale = max(abs(swim), 1e-9)
        features.append(np.column_stack([as_vectors(c) for c in columns]) / scale)
        velocities.append(as_vectors(v) / scale)
    size = np.sqrt(np.nanmean(np.concatenate(features) ** 2, axis=0)) + 1e-12
    return velocities, [f / size for f in features]


def _fit(
    velocity: list[np.ndarray], features: list[np.ndarray], rows: np.ndarray, threshold: float,
) -> np.ndarray:
    """Coefficients (2, F) by STLSQ over some rows of all particles."""
    from pysindy import STLSQ

    x, y = _stack(velocity, features, rows)
    optimizer = STLSQ(threshold=float(threshold), alpha=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # it says so where it drops every term
        optimizer.fit(x, y)
    return np.asarray(optimizer.coef_)


def _error(
    velocity: list[np.ndarray], features: list[np.ndarray], held: np.ndarray, threshold: float,
) -> float:
    coefficients = _fit(velocity, features, ~held, threshold)
    x, y = _stack(velocity, features, held)
    return float(((y - x @ coefficients.T) ** 2).sum())


def _stack(
    velocity: list[np.ndarray], features: list[np.ndarray], rows: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    x = np.concatenate([f[rows] for f in features])
    y = np.concatenate([v[rows] for v in velocity])
    whole = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    return x[whole], y[whole]
