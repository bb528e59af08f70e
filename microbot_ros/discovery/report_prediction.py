"""The predictive check: measured tracks against the band in which the model found expects them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.discovery.result import Discovery
from microbot_ros.estimation.noise import GainLikelihood
from microbot_ros.model.increments import increments
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.timeline import Timeline
from microbot_ros.records import Session

SHORTEST, MOST = 10.0, 12
"""Predictions start anew from the measured place after this long [s], but not more often."""

EDGE = 1.645
"""The 5 % and 95 % points of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Prediction:
    """Measured less predicted positions of a session, predicted without looking for a while.

    `times` (T,) [s]; `names` of the N particles; `measured` and `without` (N, T, 2) [m] are
    against the model found and the first-order model, NaN for gaps; the model found expects nine
    in ten coordinates within ± `band` (N, T) [m], by diffusion and localisation. `restarts`
    (N, T) says where it starts anew, until the particle is seen.
    """

    times: np.ndarray
    names: tuple[str, ...]
    measured: np.ndarray
    without: np.ndarray
    band: np.ndarray
    restarts: np.ndarray

    @property
    def inside(self) -> float:
        """The fraction of all measured coordinates within the band, restarts left out."""
        known = np.isfinite(self.measured) & ~self.restarts[..., None]
        within = np.abs(self.measured) <= self.band[..., None]
        return float(within[known].mean()) if known.any() else float('nan')


def predict(found: Discovery, session: Session) -> Prediction:
    """The check of the session that `found.particles` belong to: the last one."""
    start = session.commands.t[np.hypot(*session.commands.field.T) > 0][0]
    times, positions = session.tracks.grid()
    rows = (times >= start).nonzero()[0]
    columns = np.isin(session.tracks.particles, found.particles.ids)
    times, positions = times[rows], positions[rows][:, columns]
    timeline = Timeline(session.commands, times, _filled(positions))
    plain = Model.baseline(session.conditions, session.commands)
    moved = _moved(found.model, found.particles, timeline)
    rest = _moved(plain, _refitted(plain, found, timeline, positions), timeline)
    block = ((times - times[0]) / max(SHORTEST, float(np.ptp(times)) / MOST)).astype(int)
    measured, elapsed = _restarted(positions - moved, times, block)
    without, _ = _restarted(positions - rest, times, block)
    variance = 2 * found.diffusion.value * elapsed + 2 * found.localisation.value**2
    return Prediction(
        times, tuple(str(i) for i in found.particles.ids), measured, without,
        EDGE * np.sqrt(variance), elapsed == 0)


def _filled(positions: np.ndarray) -> np.ndarray:
    """The last known place (T, N, 2) where a particle is not seen; NaN before the first."""
    seen = np.isfinite(positions[..., 0])
    last = np.maximum.accumulate(np.where(seen, np.arange(len(seen))[:, None], 0), axis=0)
    return np.take_along_axis(positions, last[..., None], axis=0)


def _moved(model: Model, particles: ParticleParameters, timeline: Timeline) -> np.ndarray:
    """Displacements (T, N, 2) [m] that a model expects since the first frame."""
    steps = np.nan_to_num(increments(model, particles, timeline))
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def _refitted(plain: Model, found: Discovery, timeline: Timeline,
              positions: np.ndarray) -> ParticleParameters:
    """The particles as the first-order model alone sees them, under the same noise."""
    unit = ParticleParameters(found.particles.ids, np.ones(positions.shape[1]),
                              np.zeros(positions.shape[1]))
    path = _moved(plain, unit, timeline) @ np.array([1, 1j])
    z = positions @ np.array([1, 1j])
    ratio = max(found.localisation.value**2 / found.diffusion.value, 1e-6)
    gain = GainLikelihood(timeline.times, z, path).at(ratio).gain
    return ParticleParameters.from_velocity(found.particles.ids, gain)


def _restarted(left: np.ndarray, times: np.ndarray,
               block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differences (N, T, 2) counted from the first one in every block, and the time since."""
    left = np.moveaxis(left, 0, 1).copy()
    elapsed = np.full(left.shape[:2], np.nan)
    for n, of_particle in enumerate(left):
        for b in range(block[-1] + 1):
            rows = np.flatnonzero(block == b)
            seen = rows[np.isfinite(of_particle[rows, 0])]
            if seen.size:
                of_particle[rows] -= of_particle[seen[0]].copy()
                elapsed[n, rows] = np.maximum(times[rows] - times[seen[0]], 0.0)
    return left, elapsed
