"""Sequential test of whether the model explains the data, with few false alarms in total.

Under the model the filter's innovations are white, of unit variance, and independent of all that
was known before them. Each way in which they may not be has a *detector*: a bet at fair odds that
the innovations depend on some known quantity x. With S = Σ Re(x* z) and V = Σ |x|² the stake grows
by exp(λS − |λ|εV − λ²V/2), on average not at all while the dependence is within the tolerance ε.
New stakes are added all the time (Shiryaev–Roberts), so a change at any moment is found. The sum
of all stakes after n ticks exceeds a bound b with a probability of at most n/b, for any data and
any duration (Ville's inequality; e-detectors of Shin, Ramdas and Rinaldo 2022).
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba

TICK = 0.5
"""Time [s] between evaluations of the stakes. Choice: the delay of an alarm at most."""

BOUND = 10.0 * 3600 / TICK * 20
"""Sum of stakes that raises an alarm: at most 1 false alarm in 20 times ten hours.

Choice: an alarm is worth a look; a tenth of the rate delays it by log 10 in evidence.
"""

HOLD = 30.0
"""Time [s] for which an alarm stays after its last confirmation. Choice: enough to read it."""

LEANS = np.array([0.03, 0.1, 0.3, 0.8])
"""Tested dependences, in standard deviations of an innovation. Choice: a factor of 3 apart."""

SPREADS = np.array([0.3, 0.5, 2.0, 4.0])
"""Tested variances of the innovations, where 1 is correct. Choice: a factor of 2 apart."""

TOLERATED_SPREAD = 1.3
"""Variance up to which, or to its inverse, there is no alarm.

Choice: noise levels are learned, not known; a smaller value alarms on errors of these.
"""

PLACE_SCALE = 100e-6
"""Unit of length [m] of the dependence on place. Choice: a usual field of view."""

AFTER_TURN = 0.3
"""Time [s] over which innovations may depend on the last turn. Choice: a usual alignment time."""


@dataclass(frozen=True)
class Detector:
    """Bet on one dependence of the innovations.

    Attributes
    ----------
    name : str
        Name of the detector.
    tolerance : float
        Dependence that raises no alarm, in standard deviations of an innovation.
    sentence : str
        Cause and advice, for people.
    stake : float
        Share of the bet; small for what is only a symptom of other dependences.
    """

    name: str
    tolerance: float
    sentence: str
    stake: float = 1.0


_RUN = 'record a minute and run: microbot discover SESSION'
"""Advice to run a search."""

DETECTORS = {s.name: s for s in (
    Detector('drift', 0.01, f'all particles drift in one direction (a flow?): {_RUN}'),
    Detector('place', 0.01, 'residuals depend on position (a flow, a gradient, a hot spot?): '
                            f'let the particles visit the whole field of view and {_RUN}'),
    Detector('command', 0.01, 'residuals depend on the direction of the field (a background '
                              'field, unequal coils?): turn the field through all directions, '
                              f'{_RUN}'),
    Detector('turn', 0.12, 'particles turn too late or too early (alignment lag, delay?): command '
                           f'turns of 30° and of 180°, {_RUN}'),
    Detector('swimming', 0.02, 'speed or direction changes too fast to be tracked (fuel, slip?): '
                               f'{_RUN}', 1e-2),
    Detector('memory', 0.06, 'residuals of successive frames are correlated (noise '
                             f'levels, heading noise, vibration?): {_RUN}', 0.03),
    Detector('size', 0.0, 'residuals do not match the noise (focus, tracking, an unknown '
                          'effect?): look at the image, then run: microbot fit SESSION',
              1e-2),
)}
"""All detectors by name. Choice: tolerances are what learned noise, delay and speeds leave."""

FEATURES = (
    'drift', 'drift', 'place', 'place', 'place', 'place', 'swimming', 'swimming',
    'command', 'command', 'command', 'command', 'command', 'command', 'command', 'command',
    'turn', 'turn', 'memory',
)
"""The detector of each quantity in `_add`."""


class Monitor:
    """Tests of the innovations of all particles together."""

    def __init__(self) -> None:
        tolerance = np.array([DETECTORS[name].tolerance for name in FEATURES])[:, None]
        self._lean = np.concatenate([LEANS, -LEANS])
        stake = np.array([DETECTORS[name].stake for name in FEATURES])
        total = stake.sum() * len(self._lean) + DETECTORS['size'].stake * len(SPREADS)
        self._stake = stake[:, None] / total
        self._stake_size = DETECTORS['size'].stake / total
        self._cost = np.abs(self._lean) * tolerance + self._lean**2 / 2
        self._leans = np.zeros((len(FEATURES), len(self._lean)))
        self._spreads = np.zeros(len(SPREADS))
        self._alarms: dict[str, float] = {}
        self._next = -np.inf
        self._turned = np.array([-np.inf, 0.0])
        """Time of the last turn of the field [s], and its sense."""
        self._heading = np.zeros(1, complex)
        self._before: tuple[np.ndarray, np.ndarray] = (np.empty(0, int), np.empty(0, complex))
        self._clear()

    def _clear(self) -> None:
        self._score = np.zeros(len(FEATURES))
        self._power = np.zeros(len(FEATURES))
        self._squares, self._count = 0.0, 0

    def add(
        self, t: float, ids: np.ndarray, innovation: np.ndarray, place: np.ndarray,
        heading: np.ndarray, swimming: np.ndarray,
    ) -> None:
        """Add a frame.

        All quantities except the innovations were known before the frame.

        Parameters
        ----------
        t : float
            Time [s].
        ids : ndarray of int, shape (N,)
            Particles, ascending.
        innovation : ndarray of complex, shape (N,)
            Whitened innovations; NaN where there is none.
        place : ndarray of complex, shape (N,)
            Predicted positions [m].
        heading : ndarray of complex, shape (1 or N,)
            e^{i(θ−φ)}.
        swimming : ndarray of complex, shape (N,)
            Unit phasors of the direction of travel; 0 where unknown.
        """
        squares, count = _add(
            self._score, self._power, innovation, place, heading, self._heading, swimming, ids,
            *self._before, t, self._turned)
        self._squares += squares
        self._count += count
        self._heading, self._before = heading, (ids, innovation)
        if t >= self._next:
            self._next = t + TICK
            self._raise_stakes(t)

    def _raise_stakes(self, t: float) -> None:
        growth = self._lean * self._score[:, None] - self._cost * self._power[:, None]
        self._leans = (self._leans + self._stake) * np.exp(np.clip(growth, -700, 40))
        tolerated = np.where(SPREADS > 1, TOLERATED_SPREAD, 1 / TOLERATED_SPREAD)
        spread = SPREADS * tolerated
        growth = -self._count * np.log(SPREADS) - self._squares / 2 * (1 / spread - 1 / tolerated)
        self._spreads = (self._spreads + self._stake_size) * np.exp(np.clip(growth, -700, 40))
        self._clear()
        if self._leans.sum() + self._spreads.sum() >= BOUND:
            feature = int(self._leans.max(axis=1).argmax())
            leaning = self._leans.max() >= self._spreads.max()
            self._alarms[FEATURES[feature] if leaning else 'size'] = t
            self._leans[:] = 0
            self._spreads[:] = 0
        self._alarms = {name: at for name, at in self._alarms.items() if t - at < HOLD}

    @property
    def sentences(self) -> tuple[str, ...]:
        """Present alarms, each with the command to run next."""
        return tuple(
            f'the model does not explain the data: {DETECTORS[name].sentence}'
            for name in self._alarms
        )


@numba.njit(cache=True)
def _add(score, power, innovation, place, heading, heading_before, swimming, ids, ids_before,  # type: ignore[no-untyped-def]
         before, t, turned):
    """Add a frame to the scores and powers (F,); return Σ squares and number of innovations.

    `before` are the innovations of the frame before, of particles `ids_before` (M,), which ascend
    as `ids`. `turned` (2,) is updated where the heading has turned.
    """
    if len(heading) == len(heading_before):
        angle = cmath.phase((heading * heading_before.conj()).sum())
        if abs(angle) > 0.05:
            turned[0], turned[1] = t, math.copysign(1.0, angle)
    fresh = math.exp(-(t - turned[0]) / AFTER_TURN)
    squares, count, m = 0.0, 0, 0
    x = np.empty(len(score), np.complex128)
    for n in range(len(ids)):
        z, swims, u = innovation[n], swimming[n], heading[min(n, len(heading) - 1)]
        if math.isnan(z.real):
            continue
        twice = u * u
        x[0] = 1.0
        x[2] = min(max(place[n].real / PLACE_SCALE, -3.0), 3.0)
        x[4] = min(max(place[n].imag / PLACE_SCALE, -3.0), 3.0)
        x[6] = swims
        for k in range(0, 8, 2):
            x[k + 1] = 1j * x[k]
        x[8], x[9], x[10], x[11] = (
            swims * u.real, swims * u.imag, swims * twice.real, swims * twice.imag)
        for k in range(8, 12):
            x[k + 4] = 1j * x[k]
        x[16], x[17] = 1j * swims * turned[1] * fresh, swims * fresh
        while m < len(ids_before) and ids_before[m] < ids[n]:
            m += 1
        x[18] = before[m] if m < len(ids_before) and ids_before[m] == ids[n] else 0.0
        if math.isnan(x[18].real):
            x[18] = 0.0
        for k in range(len(x)):
            score[k] += x[k].real * z.real + x[k].imag * z.imag
            power[k] += x[k].real**2 + x[k].imag**2
        squares += z.real**2 + z.imag**2
        count += 1
    return squares, count
