"""Which particles there are, and one frame's readings brought to the filter: gated, born, dropped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.estimation.bank import PhasorBank
from microbot_ros.estimation.heading_bank import HeadingBank

HYPOTHESES = 7
"""Nothing changed, or c changed about 0.25, 0.5, 1, 2, 4 or 8 s ago."""

TICK = 0.25
"""Seconds between moments at which a change of c is considered."""

GATE = 30.0
"""Squared distance beyond which a reading is an outlier: χ² of two axes, 3e-7 by chance."""

JUMP_FRAMES = 5
"""Consecutive outliers after which the particle really is there."""


@dataclass(frozen=True)
class Readings:
    """What became of a frame's readings: all (N,) over the population.

    `used` the readings that the filter took; `innovation` complex, whitened to unit variance per
    axis, NaN where none was taken; `jump` complex [m], by how far a particle was moved, else 0.
    Known before the frame: the `predicted` place [m] and `direction`, the unit phasor of c, 0
    where that is not known to within a third. `z` are the places read [m].
    """

    z: np.ndarray
    used: np.ndarray
    predicted: np.ndarray
    direction: np.ndarray
    innovation: np.ndarray
    jump: np.ndarray


class Population:
    """Particles by identity, `ids` (N,) ascending, each a column of the filter bank.

    A new one has a velocity phasor of 0 ± `phasor_prior_std` [m/s, or m/s/Hz] per axis.
    """

    def __init__(self, phasor_prior_std: float) -> None:
        self.bank = PhasorBank(HYPOTHESES)
        self.ids = np.empty(0, int)
        self.last_seen = np.empty(0)
        self._phasor_prior_var = phasor_prior_std**2
        self._outliers = np.empty(0, int)
        self._next_tick = -np.inf

    def track_heading_deviations(self) -> None:
        """From now on, make the deviation of every heading from the model's a state too."""
        if not isinstance(self.bank, HeadingBank):
            self.bank = HeadingBank.of(self.bank)

    def take(self, t: float, ids: np.ndarray, z: np.ndarray, reading: np.ndarray) -> Readings:
        """Bring a frame's readings at `t` [s] to the filter: gate, admit, update.

        Of distinct particles `ids` (n,): complex positions `z` [m], `reading` their variance [m²].
        """
        born = self._admit(t, ids, z, reading)
        rows = np.searchsorted(self.ids, ids)
        place, noise = np.zeros(len(self.ids), complex), np.ones(len(self.ids))
        seen = np.zeros(len(self.ids), bool)
        place[rows], noise[rows], seen[rows] = z, reading, True
        predicted, direction = self.bank.p[0].copy(), self._direction()
        innovation, variance = self.bank.innovation(place, noise)
        weight = self.bank.weights()
        distance = np.where(weight > 0, np.abs(innovation) ** 2 / variance, np.inf).min(axis=0)
        outlier = seen & ~(distance <= GATE)
        self._outliers = np.where(outlier, self._outliers + 1, np.where(seen, 0, self._outliers))
        jumped = outlier & (self._outliers >= JUMP_FRAMES)
        jump = np.where(jumped, place - (weight * self.bank.p).sum(axis=0), 0)
        self.bank.restart_position(place, noise, jumped)
        self._outliers[jumped] = 0
        used = seen & ~outlier
        lead = weight.argmax(axis=0), np.arange(len(self.ids))
        whitened = np.where(used & ~born, innovation[lead] / np.sqrt(variance[lead]), np.nan)
        self.bank.update(place, noise, used & ~born)
        self.last_seen[seen] = t
        return Readings(place, used, predicted, direction, whitened, jump)

    def _direction(self) -> np.ndarray:
        c, size = self.bank.velocity_phasor[0], np.abs(self.bank.velocity_phasor[0])
        certain = size > 3 * np.sqrt(self.bank.phasor_var[0])
        return np.where(certain, c, 0) / np.where(certain, size, 1)

    def consider_changes(self, t: float, interval: float) -> np.ndarray:
        """Reopen hypotheses at `t` [s] if it is time; seconds since c changed (N,), else 0.

        `interval` is the mean time [s] between changes of one particle.
        """
        if t < self._next_tick:
            return np.zeros(len(self.ids))
        self._next_tick = t + TICK
        size = np.maximum(np.abs(self.bank.velocity_phasor[0]) ** 2 / 2, self.bank.phasor_var[0])
        return TICK * self.bank.tick(TICK / interval, size, self._phasor_prior_var)

    def forget(self, before: float) -> None:
        """Drop particles not seen since `before` [s]."""
        kept = self.last_seen >= before
        if not kept.all():
            self._select(kept)

    def _admit(self, t: float, ids: np.ndarray, z: np.ndarray, reading: np.ndarray) -> np.ndarray:
        if np.array_equal(ids, self.ids):
            return np.zeros(len(ids), bool)
        new = ~np.isin(ids, self.ids)
        if new.any():
            self.bank.add(z[new], reading[new], self._phasor_prior_var)
            self.ids = np.concatenate([self.ids, ids[new]])
            self.last_seen = np.concatenate([self.last_seen, np.full(new.sum(), t)])
            self._outliers = np.concatenate([self._outliers, np.zeros(new.sum(), int)])
            self._select(np.argsort(self.ids))
        return np.isin(self.ids, ids[new])

    def _select(self, rows: np.ndarray) -> None:
        self.bank.keep(rows)
        self.ids, self.last_seen = self.ids[rows], self.last_seen[rows]
        self._outliers = self._outliers[rows]
