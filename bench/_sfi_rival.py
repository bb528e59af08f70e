"""StochasticForceInference 2 on the same sessions, given the terms of our library by hand.

Linear terms with a coefficient each: the motion that the baseline swims, which is never counted,
and what effects of the library add to the velocity, linearised about it. Terms of place are
functions of the state, those of the command are data. Its estimator that models localisation error
and uneven sampling fits them all; PASTIS (Gerardos and Ronceray 2025) selects. It has no words
for what acts through the past or through φ; the nearest of its terms stands for each.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.model.increments import as_vectors, respond
from microbot_ros.model.model import Model
from microbot_ros.model.timeline import Timeline

LATE = 0.1
"""Seconds by which the motion is shifted for the term of lags and delays."""

DRIVEN = {
    'own': '', 'aging': 'speed_decay', 'slip': 'heading_slip', 'late': 'alignment_lag',
    'near': 'hydrodynamic_slowdown', 'weak': 'incomplete_alignment'}
PLACED = {
    'drift x': 'uniform_drift', 'drift y': 'uniform_drift', 'xx': 'linear_flow',
    'yx': 'linear_flow', 'xy': 'linear_flow', 'yy': 'linear_flow', 'gradient': 'gradient_force',
    'pull': 'coil_pull'}
"""Terms and the effects that they speak of."""


def named(session: Session) -> set[str]:
    """The effects that the terms it keeps speak of."""
    return {(DRIVEN | PLACED)[term] for term in kept(session)}


def kept(session: Session) -> list[str]:
    """The terms that it keeps beside the baseline's motion, in µm and s."""
    from SFI import OverdampedLangevinInference, TrajectoryCollection
    from SFI.trajectory.dataset import time_series_extra

    times, seen = session.tracks.grid()
    began = times >= session.commands.t[0]
    times, seen = times[began], seen[began] * 1e6
    field = session.commands.field_at(times)
    strength = np.hypot(*field.T)
    terms = _terms(seen.shape[1] > 1, np.ptp(strength) > 1e-3 * strength.max())
    data = TrajectoryCollection.from_arrays(
        X=np.nan_to_num(seen), t=times - times[0], mask=np.isfinite(seen).all(axis=2),
        extras_global={'field': time_series_extra(field / strength.max())},
        extras_local={'driven': time_series_extra(_driven(session, times, seen, terms))})
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        inference = OverdampedLangevinInference(data)
        inference.infer_force(_basis(terms))
        inference.sparsify_force(criterion='PASTIS')
    return [terms[k] for k in np.asarray(inference.force_support) if terms[k] != 'own']


def _terms(neighbours: bool, levels: bool) -> list[str]:
    """Those that a session can tell from others: all but what repeats another term."""
    idle = set() if neighbours else {'near'}
    idle |= set() if levels else {'weak', 'pull'}
    return [term for term in (*DRIVEN, *PLACED) if term not in idle]


def _basis(terms: list[str]) -> Any:
    """The terms as vectors of two components, one coefficient each."""
    import jax.numpy as jnp
    from SFI.statefunc import make_basis

    def vectors(x: Any, *, extras: dict[str, Any]) -> Any:
        right, up = jnp.eye(2)
        field = extras['field']
        strength = jnp.maximum(jnp.hypot(*field), 1e-9)
        pulled = (5 * field**2 * x - 2 * field * (field @ x)) / strength - strength * x
        placed = {
            'drift x': right, 'drift y': up, 'xx': x[0] * right, 'yx': x[0] * up,
            'xy': x[1] * right, 'yy': x[1] * up, 'gradient': pulled,
            'pull': field}
        columns = [placed[term] for term in terms if term in placed]
        return jnp.concatenate([extras['driven'], jnp.stack(columns, axis=1)], axis=1)

    return make_basis(vectors, dim=2, rank=1, n_features=len(terms), labels=terms,
                      extras_keys=('driven', 'field'), particle_extras=('driven',))


def _driven(session: Session, times: np.ndarray, seen: np.ndarray,
            terms: list[str]) -> np.ndarray:
    """Velocities (T, N, 2, terms) [µm/s] that the command causes, until the next frame."""
    model = Model.baseline(session.conditions, session.commands)
    h = np.diff(times)[:, None]
    u, late = (respond(model, Timeline(session.commands, t)).propulsion / h
               for t in (times, times - LATE))
    z = seen[..., 0] + 1j * seen[..., 1]
    moved = np.diff(z, axis=0) / h
    use = np.isfinite(moved)
    swim = (np.conj(u) * np.where(use, moved, 0)).sum(axis=0) / (np.abs(u) ** 2 * use).sum(axis=0)
    own = swim * u
    age = (times[:-1, None] - times[0]) / np.ptp(times)
    apart = np.abs(z[:-1, :, None] - z[:-1, None, :])
    apart[:, range(z.shape[1]), range(z.shape[1])] = np.inf
    strength = np.hypot(*session.commands.field_at(times[:-1]).T)[:, None]
    columns = {
        'own': own, 'aging': own * age, 'slip': 1j * own * age, 'late': swim * (late - u),
        'near': own * np.nansum(1 / apart, axis=2), 'weak': own * strength / strength.max()}
    last = [np.concatenate([c, c[-1:]]) for term, c in columns.items() if term in terms]
    return np.stack([as_vectors(c) for c in last], axis=-1)
