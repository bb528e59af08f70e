"""Particles of the online filter: gating, birth, restart and removal."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import ClassVar, NamedTuple

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.estimation.online.bank import Mixture, PhasorBank

HYPOTHESES = 7
"""Number of hypotheses: no change, or a change about 0.25, 0.5, 1, 2, 4 or 8 s ago.

Choice: older changes are part of the state; each costs time in every frame.
"""

PACES = (2e2, 3e3)
"""Variances of the walks by which c may wander, as multiples of that of a constant c.

Choice: 1.4 and 5 % in the first second. The first follows speeds that fall by 1/e in minutes, the
second those that wander by a tenth in seconds. A third pace is no better.
"""

TICK = 0.25
"""Time [s] between moments at which a change of c is considered. Choice: the least age above."""

GATE = 30.0
"""Squared distance above which a reading is an outlier: χ² of two axes, 3e-7 by chance."""

JUMP_FRAMES, JUMP_SECONDS = 5, 0.5
"""Consecutive outliers, or seconds of them (`JUMP_SECONDS`), after which the particle is
restarted.

Choice: fewer follow a confused track, more lose a particle that was moved."""

CALM, OFTEN = 10.0, 10.0
"""Time [s] for which a particle is *restless*, and the number (`OFTEN`) of restarts in it that
makes it so.

More than one restart suffices if its c has had all directions. The model does not describe what
moves such a particle. A swimmer that is late after turns is restarted too, but keeps about the
same c. Choice: shorter times forget a restless particle before it is restarted again."""

AGAIN = 1.5
"""Restarts in CALM seconds, decaying, above which the last was not the only one.

Choice: one counts 1, two within 7 s more than 1.5.
"""

SAME = 1 / 3
"""Smallest |mean of c|² over the mean of |c|² of a particle that follows the field.

Choice: as of directions spread evenly over ±100°.
"""

KNOWN = 0.01
"""Fraction of its prior variance below which c is known. Choice: a tenth of the prior's width."""

MOST_CORRECTED = 2.0
"""Factor on speeds above which a better delay does not correct them.

Choice: a larger one is extrapolation.
"""


class Readings(NamedTuple):
    """Readings of a frame for all N particles of the population.

    Attributes
    ----------
    z : ndarray of complex, shape (N,)
        Positions of the particles that were `seen` [m].
    seen, used : ndarray of bool, shape (N,)
        Which have a reading, and which readings the filter used.
    predicted : ndarray of complex, shape (N,)
        Position predicted before the frame [m].
    direction : ndarray of complex, shape (N,)
        Unit phasor of c before the frame; 0 if not known to within a third.
    innovation : ndarray of complex, shape (N,)
        Whitened to unit variance per axis; NaN where unused.
    jump : ndarray of complex, shape (N,)
        Distance by which a particle was moved [m]; else 0.
    jumped : ndarray of int
        Indices of moved particles.
    restless : ndarray of bool, shape (N,)
        Particles from which nothing should be learned.
    """

    z: np.ndarray
    seen: np.ndarray
    used: np.ndarray
    predicted: np.ndarray
    direction: np.ndarray
    innovation: np.ndarray
    jump: np.ndarray
    jumped: np.ndarray
    restless: np.ndarray


class Population:
    """Particles by identity, `ids` (N,) ascending, each a column of the filter bank.

    Parameters
    ----------
    phasor_prior_std : float
        Standard deviation of a new particle's velocity phasor per axis [m/s, or m/s/Hz].
    """

    _BIRTH: ClassVar[dict[str, complex]] = {
        'last_seen': -np.inf, '_outliers': 0, '_refused': -np.inf, '_begun': -np.inf,
        'restarts': 0.0, '_restless_until': -np.inf, '_phasor_mean': 0j, '_phasor_power': 0.0}
    """Values of a new particle."""

    def __init__(self, phasor_prior_std: float) -> None:
        self.bank = PhasorBank(HYPOTHESES, PACES)
        self.ids = np.empty(0, int)
        self.last_seen = np.empty(0)
        self._phasor_prior_var = phasor_prior_std**2
        self._outliers = np.empty(0, int)
        self._refused, self._begun, self._restless_until = np.empty((3, 0))
        """Times [s] of the first of consecutive outliers, of the last restart, and of the end of
        restlessness."""
        self.restarts = np.empty(0)
        """Restarts in the last CALM seconds, decaying."""
        self._phasor_mean, self._phasor_power = np.empty(0, complex), np.empty(0)
        """Means of c and |c|² over the last CALM seconds in which c was known, decaying."""
        self._next_tick = -np.inf

    def take(self, t: float, ids: np.ndarray, z: np.ndarray, reading: np.ndarray) -> Readings:
        """Gate the readings of a frame, admit new particles, and update the filter.

        Parameters
        ----------
        t : float
            Time [s].
        ids : ndarray of int, shape (n,)
            Distinct particles.
        z : ndarray of complex, shape (n,)
            Positions [m].
        reading : ndarray, shape (n,)
            Variances of the positions [m²].

        Returns
        -------
        Readings
            For all particles of the population.
        """
        born = self._admit(t, ids, z, reading)
        bank, weight = self.bank, self.bank.weights()
        restless = self._restless_until > t
        readings, noise, taken = _gate(
            self.ids, ids, z, reading, born, weight, bank.p, bank.velocity_phasor, bank.g,
            bank.p_var, bank.phasor_var, self._outliers, self.last_seen, self._refused,
            restless, t)
        found = Readings(*readings)
        if len(found.jumped):
            self._begin_anew(t, found, noise)
        bank.update(found.z, noise, taken)
        return found

    def _begin_anew(self, t: float, readings: Readings, noise: np.ndarray) -> None:
        rows = readings.jumped
        self.restarts[rows] *= np.exp((self._begun[rows] - t) / CALM)
        self.restarts[rows] += 1
        self._begun[rows] = t
        same = np.abs(self._phasor_mean[rows]) ** 2 >= SAME * self._phasor_power[rows]
        again = self.restarts[rows]
        restless = rows[(again > OFTEN) | (again > AGAIN) & ~same]
        self._restless_until[restless] = t + CALM
        readings.restless[restless] = True
        self.bank.restart(rows, readings.z[rows], noise[rows], self._phasor_prior_var)

    def known(self, t: float, held: Collection[int] = ()) -> Mixture:
        """Return the estimates.

        Parameters
        ----------
        t : float
            Time [s].
        held : collection of int, optional
            Particles that a wall holds.

        Returns
        -------
        Mixture
            The c of restless or held particles is that of an unknown particle.
        """
        known, unknown = self.bank.combined(), self._restless_until > t
        if held:
            unknown = unknown | np.isin(self.ids, list(held))
        if unknown.any():
            known.velocity_phasor[unknown] = known.cross[unknown] = 0
            known.phasor_var[unknown] = self._phasor_prior_var
        return known

    def begin_anew(self, names: Collection[int]) -> None:
        """Forget the c of particles.

        Parameters
        ----------
        names : collection of int
            The particles.
        """
        rows = np.flatnonzero(np.isin(self.ids, list(names)))
        if len(rows):
            known = self.bank.combined()
            self.bank.restart(rows, known.p[rows], known.p_var[rows], self._phasor_prior_var)

    def correct_velocity_phasors(self, factor: complex) -> None:
        """Multiply every c by a factor, as after a better value of the delay.

        A factor that more than doubles or halves speeds is an extrapolation: then every c may be
        what it was, or anything.

        Parameters
        ----------
        factor : complex
            The factor.
        """
        if 1 / MOST_CORRECTED < abs(factor) < MOST_CORRECTED:
            self.bank.scale_velocity_phasor(factor)
        else:
            known = self.bank.combined()
            self.bank.restart(
                np.arange(len(self.ids)), known.p, known.p_var, self._phasor_prior_var)

    def consider_changes(self, t: float, interval: float) -> list[tuple[int, float]]:
        """Reopen hypotheses if it is time.

        Parameters
        ----------
        t : float
            Time [s].
        interval : float
            Mean time between changes of one particle [s].

        Returns
        -------
        list of (int, float)
            Indices of particles whose c changed, and how long ago [s].
        """
        if t < self._next_tick:
            return []
        self._next_tick = t + TICK
        known = self.bank.combined()
        learned = np.where(known.phasor_var < KNOWN * self._phasor_prior_var, TICK / CALM, 0)
        c = known.velocity_phasor
        self._phasor_mean += learned * (c - self._phasor_mean)
        self._phasor_power += learned * (np.abs(c) ** 2 - self._phasor_power)
        size = np.maximum(np.abs(self.bank.velocity_phasor[0]) ** 2 / 2, self.bank.phasor_var[0])
        ago = TICK * self.bank.tick(TICK / interval, size, self._phasor_prior_var)
        return [(int(row), float(ago[row])) for row in np.flatnonzero(ago)]

    def forget(self, before: float) -> None:
        """Drop particles that were not seen recently.

        Parameters
        ----------
        before : float
            Time of the last sighting below which they are dropped [s].
        """
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
            for name, value in self._BIRTH.items():
                born = np.full(new.sum(), value)
                setattr(self, name, np.concatenate([getattr(self, name), born]))
            self._select(np.argsort(self.ids))
        return np.isin(self.ids, ids[new])

    def _select(self, rows: np.ndarray) -> None:
        self.bank.keep(rows)
        self.ids = self.ids[rows]
        for name in self._BIRTH:
            setattr(self, name, getattr(self, name)[rows])


@numba.njit(cache=True, error_model='numpy')
def _gate(ids, seen_ids, z, reading, born, weight, p, c, g, p_var, phasor_var, outliers,  # type: ignore[no-untyped-def]
          last_seen, refused, restless, t):
    """Return the fields of `Readings`, the readings' variances and what to update, (N,)."""
    hypotheses, count = p.shape
    place, noise = np.zeros(count, np.complex128), np.ones(count)
    seen = np.zeros(count, np.bool_)
    used, taken = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    innovation = np.full(count, np.nan + 0j)
    jumped, jump = np.zeros(count, np.bool_), np.zeros(count, np.complex128)
    predicted, direction = p[0].copy(), np.zeros(count, np.complex128)
    for n in range(count):
        size = abs(c[0, n])
        if size > 3 * math.sqrt(phasor_var[0, n]):
            direction[n] = c[0, n] / size
    for m, n in enumerate(np.searchsorted(ids, seen_ids)):
        place[n], noise[n], last_seen[n], seen[n] = z[m], reading[m], t, True
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
        if outliers[n] == 1:
            refused[n] = t
        if outliers[n] and (outliers[n] >= JUMP_FRAMES or t - refused[n] >= JUMP_SECONDS):
            jumped[n], jump[n], outliers[n] = True, z[m] - mean, 0
        taken[n] = used[n] and not born[n]
        if taken[n] and not restless[n]:
            off, variance = _innovation(
                z[m], p[lead, n], g[lead, n], p_var[lead, n], phasor_var[lead, n])
            innovation[n] = off / math.sqrt(variance + reading[m])
    readings = (place, seen, used, predicted, direction, innovation, jump, np.flatnonzero(jumped),
                restless)
    return readings, noise, taken


@numba.njit(cache=True, inline='always')
def _innovation(z, p, g, p_var, phasor_var):  # type: ignore[no-untyped-def]
    """Return place less prediction, and its variance per axis without the reading's own."""
    return z - p, p_var + (g.real**2 + g.imag**2) * phasor_var
