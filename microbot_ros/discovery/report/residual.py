"""Residuals of the final and the first-order model, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.records import Commands, Session
from microbot_ros.discovery.result import Discovery
from microbot_ros.estimation.identities import settle_identities
from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import SessionFit, Whitening
from microbot_ros.estimation.likelihood.prepared_session import JUMP, PreparedSession, prepare
from microbot_ros.model.increments import as_vectors
from microbot_ros.model.model import Model, ParticleParameters

PLACES = 10
"""Squares along the longer side of the area that the tracks cover.

Choice: more squares have fewer data each, fewer hide structure.
"""


@dataclass(frozen=True)
class Residual:
    """Measured positions less expected displacements of N particles in T frames.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Times [s] from the first frame.
    commands : Commands
        Commands on the same clock.
    names : tuple of str
        Names of the particles.
    places : ndarray, shape (T, N, 2)
        Last seen positions [m].
    found, plain : ndarray, shape (T, N, 2)
        Positions less the displacement since the first frame [m] by the final and the first-order
        model; NaN in gaps.
    path : ndarray, shape (T, N, 2)
        Path of a particle of unit speed and φ = 0 [s], for rollers [s·Hz].
    speed_std : ndarray, shape (N,)
        Standard deviation of v beside the effects, including what these do not let one tell from
        v.
    jumps : ndarray of bool, shape (T, N)
        Steps larger than any motion.
    """

    times: np.ndarray
    commands: Commands
    names: tuple[str, ...]
    places: np.ndarray
    found: np.ndarray
    plain: np.ndarray
    path: np.ndarray
    speed_std: np.ndarray
    jumps: np.ndarray


def residual(found: Discovery, session: Session) -> Residual:
    """Return the residuals of the last session, which the particles of a result belong to.

    Particles excluded from the fit are excluded here too.

    Parameters
    ----------
    found : Discovery
        Result of the search.
    session : Session
        Its last session.

    Returns
    -------
    Residual
        Of the final and the first-order model.
    """
    session, _ = settle_identities(session)
    session = replace(session, tracks=session.tracks.of(found.particles.ids))
    whole, prepared = (_with_phi(one, found.particles) for one in (
        PreparedSession.of(session), prepare(session)))
    positions = whole.causal_positions
    places = _filled(positions)
    model = Model.baseline(session.conditions, session.commands)
    ratio = max(found.localisation.value**2 / found.diffusion.value, 1e-6)
    plain = ExpectedDisplacement.of(model, whole.timeline)
    refitted = SessionFit.of(prepared, Whitening(ratio), plain).velocity_phasor
    beside = SessionFit.of(
        prepared, Whitening(ratio), ExpectedDisplacement.of(found.model, prepared.timeline))
    moved = ExpectedDisplacement.of(found.model, replace(
        whole, causal_positions=places).timeline).at(found.particles.velocity_phasor)
    steps = np.hypot(*np.moveaxis(np.diff(positions, axis=0, prepend=np.nan), -1, 0))
    return Residual(
        whole.times, whole.commands, tuple(str(i) for i in found.particles.ids), places,
        positions - as_vectors(moved),
        positions - as_vectors(plain.at(refitted[prepared.main])),
        as_vectors(np.broadcast_to(plain.along, whole.z.shape)), beside.phasor_std[prepared.main],
        np.nan_to_num(steps) > JUMP * np.nanquantile(steps, 0.99))


def _with_phi(session: PreparedSession, particles: ParticleParameters) -> PreparedSession:
    """Return the `session` with φ of every track, for terms that depend on the heading."""
    return replace(session, phi=particles.phi[particles.ids.searchsorted(session.ids)])


def by_place(left: Residual, positions: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return mean residual velocities by place.

    Places are squares that were visited for a fifth of the usual time or longer.

    Parameters
    ----------
    left : Residual
        Residuals of the session.
    positions : ndarray, shape (T, N, 2)
        `left.found` or `left.plain`.

    Returns
    -------
    place : ndarray, shape (P, 2)
        Mean positions [m].
    velocity : ndarray, shape (P, 2)
        Mean residual velocities [m/s].
    time : ndarray, shape (P,)
        Particle time spent there [s].
    """
    step, span = np.diff(positions, axis=0), np.diff(left.times)[:, None]
    used = np.isfinite(step[..., 0]) & ~left.jumps[1:]
    if not used.any():
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    where, step, span = left.places[:-1][used], step[used], np.broadcast_to(span, used.shape)[used]
    low, size = where.min(axis=0), max(float(np.ptp(where, axis=0).max()), 1e-9) / PLACES
    cell = ((where - low) / size).astype(int) @ np.array([1, PLACES + 1])
    cells, which = np.unique(cell, return_inverse=True)
    time = np.bincount(which, span)
    place, velocity = (
        np.stack([np.bincount(which, x[:, k]) for k in (0, 1)], axis=1) for x in (where, step))
    enough = time > 0.2 * time.sum() / len(cells)
    count = np.bincount(which)[:, None]
    return (place / count)[enough], (velocity / time[:, None])[enough], time[enough]


def _filled(positions: np.ndarray) -> np.ndarray:
    """Return positions (T, N, 2) with gaps filled by the last place; NaN before the first."""
    seen = np.isfinite(positions[..., 0])
    last = np.maximum.accumulate(np.where(seen, np.arange(len(seen))[:, None], 0), axis=0)
    return np.take_along_axis(positions, last[..., None], axis=0)
