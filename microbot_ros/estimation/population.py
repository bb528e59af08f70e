"""Which particles there are, and one frame's readings brought to the filter: gated, born, dropped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
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


class Readings(NamedTuple):
    """What became of a frame's readings: all (N,) over the population.

    `used` the readings that the filter took; `innovation` complex, whitened to unit variance per
    axis, NaN where none was taken; `jump` complex [m], by how far a particle was moved, else 0,
    and `jumped`, the rows where one was. Known before the frame: the `predicted` place [m] and
    `direction`, the unit phasor of c, 0 where that is not known to within a third. `z` are the
    places read [m].
    """

    z: np.ndarray
    used: np.ndarray
    predicted: np.ndarray
    direction: np.ndarray
    innovation: np.ndarray
    jump: np.ndarray
    jumped: np.ndarray


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
        bank, weight = self.bank, self.bank.weights()
        readings, noise, jumped, taken = _gate(
            self.ids, ids, z, reading, born, weight, bank.p, bank.velocity_phasor, bank.g,
            bank.p_var, bank.phasor_var, self._outliers, self.last_seen, t)
        found = Readings(*readings)
        if len(found.jumped):
            bank.restart_position(found.z, noise, jumped)
        bank.update(found.z, noise, taken)
        return found

    def consider_changes(self, t: float, interval: float) -> list[tuple[int, float]]:
        """Reopen hypotheses at `t` [s] if it is time: rows whose c changed, and how long ago [s].

        `interval` is the mean time [s] between changes of one particle.
        """
        if t < self._next_tick:
            return []
        self._next_tick = t + TICK
        size = np.maximum(np.abs(self.bank.velocity_phasor[0]) ** 2 / 2, self.bank.phasor_var[0])
        ago = TICK * self.bank.tick(TICK / interval, size, self._phasor_prior_var)
        return [(int(row), float(ago[row])) for row in np.flatnonzero(ago)]

    def forget(self, before: float) -> None:
        """Drop particles not seen since `before` [s]."""
        kept = self.last_seen >= before
        if not kept.all():
            self._select(kept)

    def _admit(self, t: float, ids: np.ndarray, z: np.ndarray, reading: np.ndarray) -> np.ndarray:
        if len(ids) == len(self.ids) and (ids == self.ids).all():
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


@numba.njit(cache=True, error_model='numpy')
def _gate(ids, seen_ids, z, reading, born, weight, p, c, g, p_var, phasor_var, outliers,  # type: ignore[no-untyped-def]
          last_seen, t):
    """The fields of `Readings`, and (N,): the readings' variance, who jumped, whom to update."""
    hypotheses, count = p.shape
    place, noise = np.zeros(count, np.complex128), np.ones(count)
    used, taken = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    innovation = np.full(count, np.nan + 0j)
    jumped, jump = np.zeros(count, np.bool_), np.zeros(count, np.complex128)
    predicted, direction = p[0].copy(), np.zeros(count, np.complex128)
    for n in range(count):
        size = abs(c[0, n])
        if size > 3 * math.sqrt(phasor_var[0, n]):
            direction[n] = c[0, n] / size
    for m, n in enumerate(np.searchsorted(ids, seen_ids)):
        place[n], noise[n], last_seen[n] = z[m], reading[m], t
        nearest, mean, lead = np.inf, 0j, 0
        for k in range(hypotheses):
            mean += weight[k, n] * p[k, n]
            if weight[k, n] > weight[lead, n]:
                lead = k
            if weight[k, n] > 0:
                off, variance = _innovation(z[m], p[k, n], g[k, n], p_var[k, n], phasor_var[k, n])
                variance += reading[m]
                nearest = min(nearest, (off.real**2 + off.imag**2) / variance)
        used[n] = nearest <= GATE
        outliers[n] = 0 if used[n] else outliers[n] + 1
        if outliers[n] >= JUMP_FRAMES:
            jumped[n], jump[n], outliers[n] = True, z[m] - mean, 0
        taken[n] = used[n] and not born[n]
        if taken[n]:
            off, variance = _innovation(
                z[m], p[lead, n], g[lead, n], p_var[lead, n], phasor_var[lead, n])
            innovation[n] = off / math.sqrt(variance + reading[m])
    readings = place, used, predicted, direction, innovation, jump, np.flatnonzero(jumped)
    return readings, noise, jumped, taken


@numba.njit(cache=True, inline='always')
def _innovation(z, p, g, p_var, phasor_var):  # type: ignore[no-untyped-def]
    """Place less prediction, and the variance of that per axis, but for the reading's own."""
    return z - p, p_var + (g.real**2 + g.imag**2) * phasor_var
