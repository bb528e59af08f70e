"""Covariates of the residual, as groups of smooth velocity fields of one covariate each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ros.estimation.likelihood.joint import SessionFit
from microbot_ros.estimation.likelihood.prepared_session import HELD
from microbot_ros.model.effect_context import CLOSEST

HARMONICS = 4
"""Harmonics of an angle. Choice: effects of the library have two at most; more dilute the test."""

RELAXATION = (HELD, 0.3, 1.0, 3.0)
"""Relaxation times after a switch [s].

Choice: from the shortest hold to a usual step of commands, a factor of 3 apart.
"""

FEWEST = 3
"""Fewest switches in a recording for a test of a common response.

Choice: two may agree by chance.
"""


@dataclass(frozen=True)
class Group:
    """Velocity fields of one covariate.

    Attributes
    ----------
    against : str
        Name of the covariate.
    label : str
        Axis label, with unit.
    fields : ndarray of complex, shape (T − 1, N, M)
        Mean velocity of each field in each frame interval; the same rotated by 90° belongs to it.
    value : ndarray, shape (T − 1, N)
        The covariate in the unit of `label`.
    frame : ndarray of complex, shape (T − 1, N)
        Direction along which the residual is drawn; 1 in the laboratory.
    """

    against: str
    label: str
    fields: np.ndarray
    value: np.ndarray
    frame: np.ndarray


class Covariates:
    """All covariates of the residual of one session.

    Parameters
    ----------
    part : SessionFit
        Fit of the session.
    """

    def __init__(self, part: SessionFit) -> None:
        self.part = part
        self.session = part.session
        times = self.session.times
        self.step = np.diff(times)[:, None]
        self.middle = ((times[1:] + times[:-1]) / 2)[:, None]
        self.shape = part.session.z[1:].shape

    @cached_property
    def body(self) -> np.ndarray:
        """Direction of travel (T − 1, N), shorter than 1 where it turns within an interval."""
        p = self.part
        c = p.velocity_phasor
        own = np.diff(p.expected.along * c.real + p.expected.across * c.imag, axis=0) / self.step
        typical = np.abs(c) * max(
            np.abs(np.diff(p.expected.along, axis=0) / self.step).max(), 1e-30)
        return own / np.where(typical > 0, typical, 1.0)

    @cached_property
    def place(self) -> np.ndarray:
        """Place at the start of every interval (T − 1, N), complex [m]; 0 out of view."""
        x = self.session.causal_positions[:-1]
        return np.nan_to_num(x[..., 0] + 1j * x[..., 1])

    def groups(self) -> Iterator[Group]:
        """Yield the groups that the session can show.

        Yields
        ------
        Group
            One covariate.
        """
        yield from self._time()
        yield from self._switch()
        yield from self._angles()
        yield from self._position()
        yield from self._strength_and_frequency()
        if len(self.session.ids) > 1:
            yield self._neighbours()
            yield self._particles()

    def _group(self, against: str, label: str, factors: list[np.ndarray], frame: np.ndarray,
               value: np.ndarray) -> Group:
        """Return the group of real factors times the frame."""
        fields = np.stack([np.broadcast_to(f * frame, self.shape) for f in factors], axis=-1)
        return Group(against, label, fields, np.broadcast_to(value, self.shape),
                     np.broadcast_to(frame, self.shape))

    def _time(self) -> Iterator[Group]:
        times = self.session.times
        phase = np.pi * (self.middle - times[0]) / (times[-1] - times[0])
        waves = [np.cos(k * phase) for k in range(9)]
        one = np.ones((1, 1), complex)
        yield self._group('time', 'time [s]', waves, one, self.middle)
        yield self._group('time, along the heading', 'time [s]', waves[1:7], self.body,
                          self.middle)

    def _switch(self) -> Iterator[Group]:
        """Yield the response to a switch in the body frame, with the turn of the command.

        A switch is a change of the command after one that was held for HELD; the turn is that
        since the held command. Commands that change all the time, as a ramp of angles or a closed
        loop, have no switch. Fewer than FEWEST switches show nothing in common.
        """
        commands, times = self.session.commands, self.session.times
        field = commands.field[:, 0] + 1j * commands.field[:, 1]
        told = np.stack([field, commands.frequency_at(commands.t)], axis=1)
        change = np.append(0, 1 + np.flatnonzero((told[1:] != told[:-1]).any(axis=1)))
        began = commands.t[change]
        switch = np.append(0, 1 + np.flatnonzero(np.diff(began) >= HELD))
        inside = (began[switch] > times[0]) & (began[switch] < times[-1])
        if np.count_nonzero(inside) < FEWEST:
            return
        latest = switch[np.maximum(np.searchsorted(began[switch], self.middle[:, 0], 'right') - 1,
                                   0)]
        since = self.middle - began[latest][:, None]
        now = field[np.maximum(commands.index_at(self.middle[:, 0]), 0)]
        turn = np.angle(now * np.conj(field[change[np.maximum(latest - 1, 0)]]))[:, None]
        fields = []
        for time in RELAXATION:
            fall = np.exp(-since / time)
            fields += [fall, fall * (1 - np.cos(turn)), fall * np.sin(turn)]
        yield self._group('time since switch', 'time since the last switch [s]', fields,
                          self.body, since)

    def _angles(self) -> Iterator[Group]:
        command = self.session.commands.field_at(self.middle[:, 0])
        driven = np.hypot(*command.T) > 0
        angle = np.arctan2(command[:, 1], command[:, 0])[:, None]
        yield self._group('command angle', 'direction of the command [°]',
                          [f * driven[:, None] for f in _harmonics(angle)], self.body,
                          np.degrees(angle))
        heading = np.angle(self.body)
        yield self._group('heading', 'direction of travel [°]', _harmonics(heading), self.body,
                          np.degrees(heading))

    def _position(self) -> Iterator[Group]:
        z = self.place
        x, y = ((p - p.mean()) / (p.std() or 1.0) for p in (z.real, z.imag))
        cubic = [x**i * y**j for i in range(4) for j in range(4 - i)]
        one = np.ones((1, 1), complex)
        yield self._group('position', 'x [µm]', cubic, one, z.real * 1e6)
        yield self._group('position, along the heading', 'x [µm]',
                          [x, y, x * y, x * x, y * y], self.body, z.real * 1e6)

    def _strength_and_frequency(self) -> Iterator[Group]:
        commands = self.session.commands
        strength = np.hypot(*commands.field_at(self.middle[:, 0]).T)
        if strength.any() and np.ptp(strength[strength > 0]) > 1e-3 * strength.max():
            yield self._group(
                'field strength', 'field [mT]', _bins(strength),
                self.body, strength[:, None] * 1e3)
        frequency = commands.frequency_at(self.middle[:, 0])
        if commands.frequency is not None and np.ptp(frequency) > 0:
            yield self._group('frequency', 'rotation [Hz]', _bins(frequency), self.body,
                              frequency[:, None])

    def _neighbours(self) -> Group:
        z = self.place
        present = np.isfinite(self.session.causal_positions[:-1, :, 0])
        apart = z[:, :, None] - z[:, None, :]
        near = present[:, :, None] & present[:, None, :] & ~np.eye(z.shape[1], dtype=bool)
        r = np.maximum(np.abs(apart), CLOSEST)
        scale = np.quantile(r[near], 0.02) if near.any() else 1.0
        away = np.where(near, apart / r, 0)
        fall = [np.where(near, (scale / r) ** power, 0) for power in (1, 2, 4)]
        theirs, own = self.body[:, None, :], self.body[:, :, None]
        fields = [(away * f).sum(axis=2) for f in fall]
        for direction in (theirs, own):
            facing = (away * np.conj(direction)).real
            fields += [(away * facing**2 * f).sum(axis=2) for f in fall[1:]]
        fields += [self.body * f.sum(axis=2) for f in fall[:2]]
        nearest = np.where(near, r, np.inf).min(axis=2) * 1e6
        direction = (away * (r == np.where(near, r, np.inf).min(axis=2)[:, :, None])).sum(axis=2)
        return Group('neighbours', 'distance of the nearest neighbour [µm]',
                     np.stack(fields, axis=-1), nearest, direction)

    def _particles(self) -> Group:
        """Return each particle's own drift, and its own change of speed and angle."""
        T, N = self.shape
        times = self.session.times
        t = (self.middle - times.mean()) / np.ptp(times)
        own = np.eye(N)[None]
        drift = np.broadcast_to(own, (T, *own.shape[1:])).astype(complex)
        change = (t * self.body)[:, :, None] * own
        fields = np.concatenate([drift, change], axis=-1)
        number = np.broadcast_to(self.session.ids.astype(float), (T, N))
        return Group('particle', 'particle', fields, number, np.ones((T, N), complex))


def _harmonics(angle: np.ndarray) -> list[np.ndarray]:
    return [f(m * angle) for m in range(1, HARMONICS + 1) for f in (np.cos, np.sin)]


def _bins(value: np.ndarray) -> list[np.ndarray]:
    """Return up to eight bins of equal counts, or the levels, each as a factor (T − 1, 1)."""
    edges = np.unique(np.quantile(value[value > 0], np.linspace(0, 1, 9)[1:]))
    which = np.searchsorted(edges, value)
    return [((which == k) & (value > 0))[:, None].astype(float) for k in range(len(edges))]
