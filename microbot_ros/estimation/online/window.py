"""The last minute of a few well-seen particles, reviewed with the batch likelihood."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.records import Conditions
from microbot_ros.estimation.likelihood.delay import Delay, DelayedFits
from microbot_ros.estimation.likelihood.excitation import excitation
from microbot_ros.estimation.likelihood.joint import search_noise_ratio
from microbot_ros.estimation.likelihood.noise import Noise
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.estimation.online.commands import CommandLog
from microbot_ros.estimation.online.propagation import HEADING_MEMORY
from microbot_ros.model.increments import as_vectors
from microbot_ros.model.model import Model

PROBES = 8
FRAMES = 3000
SECONDS = 60.0
LEAST = 40
"""A review needs at least this many increments."""

JUDGED_AFTER = 3.0
"""Seconds of data before a review says what the command cannot tell apart."""


@dataclass(frozen=True)
class Review:
    """What a window of data says of the things that all particles share.

    `noise` and `delay` as fitted; `log_phasor_slope` [1/s] is d log(v e^{iφ}) / d delay: by how
    much speed (real part) and φ (imaginary) move with it; `confounded`: sentences on what the
    command cannot tell apart.
    """

    noise: Noise
    delay: Delay
    log_phasor_slope: complex
    confounded: tuple[str, ...]


class Window:
    """Positions (T, PROBES) of up to PROBES particles over the last SECONDS or FRAMES."""

    def __init__(self) -> None:
        self._t = np.empty(2 * FRAMES)
        self._z = np.full((2 * FRAMES, PROBES), np.nan, complex)
        self._count = 0
        self.ids = np.full(PROBES, np.iinfo(int).min)
        self._shift = np.zeros(PROBES, complex)
        self._present = np.empty(0, int)
        self._rows: list[tuple[int, int]] = []
        """Each probe that is there, and its row among those present."""

    def add(self, t: float, ids: np.ndarray, z: np.ndarray, used: np.ndarray) -> None:
        """Append a frame at `t` [s]: `ids` (N,), complex places `z` (N,), `used` (N,) bool."""
        if self._count == len(self._t):
            self._t[:FRAMES], self._z[:FRAMES] = self._t[FRAMES:], self._z[FRAMES:]
            self._count = FRAMES
        if not (len(ids) == len(self._present) and (ids == self._present).all()):
            self._adopt(ids)
        row = self._z[self._count]
        row[:] = np.nan
        for probe, k in self._rows:
            if used[k]:
                row[probe] = z[k] - self._shift[probe]
        self._t[self._count] = t
        self._count += 1

    def _adopt(self, ids: np.ndarray) -> None:
        """Give probes of particles that are gone to particles that are there."""
        alive = np.isin(self.ids, ids)
        waiting = iter(np.setdiff1d(ids, self.ids) if not alive.all() else ())
        for probe in np.flatnonzero(~alive):
            name = next(waiting, None)
            if name is not None:
                self.ids[probe] = name
                self._shift[probe] = 0
                self._z[:self._count, probe] = np.nan
        place = {name: k for k, name in enumerate(ids.tolist())}
        self._present = ids
        self._rows = [(probe, place[name]) for probe, name in enumerate(self.ids.tolist())
                      if name in place]

    def jumped(self, name: int, by: complex) -> None:
        """Particle `name` was moved by `by` [m], complex: take that out of what follows."""
        self._shift[self.ids == name] += by

    def changed(self, name: int, at: float) -> None:
        """Particle `name` swims differently since `at` [s]: forget what it did before."""
        before = self._t[:self._count] < at
        self._z[:self._count][np.ix_(before, self.ids == name)] = np.nan

    def recent(self) -> tuple[np.ndarray, np.ndarray]:
        """Copies of the times (T,) and positions (T, PROBES) of the window."""
        first = max(self._count - FRAMES, 0)
        times = self._t[first:self._count]
        first += int(np.searchsorted(times, times[-1] - SECONDS)) if len(times) else 0
        kept = slice(first, self._count)
        return self._t[kept].copy(), self._z[kept].copy()

    def review(
        self, model: Model, log: CommandLog, delay: Delay, noise: Noise,
    ) -> Iterator[Review | None]:
        """Noise, delay and excitation under a `model`, a little at a time; the Review last.

        With the commands of `log`; `delay` and `noise` are those in use. Yields None whenever a
        caller with frames to serve may want to go on later; ends at once with too few frames.
        """
        times, z = self.recent()
        if np.isfinite(z).sum() - PROBES < LEAST:
            return
        commands = log.since(times[0] - HEADING_MEMORY)
        session = PreparedSession(
            '', np.arange(PROBES), times, np.nan_to_num(z), np.isfinite(z).astype(int),
            as_vectors(z), commands, Conditions(), np.zeros(PROBES, int))
        fits = DelayedFits(model, session)
        search = search_noise_ratio(fits.at(delay.value, noise.ratio))
        while (fit := next(search)) is None:
            yield None
        learned, ratio = fit.noise(noise.exposure), fit.whitening.noise_ratio
        excited = excitation(model, session, delay.value, learned)
        found = Delay()
        for result in fits.posterior(ratio) if excited.shows_delay else ():
            yield None
            found = result or found
        slope = fits.log_phasor_slope(found.value if found.determined else delay.value, ratio)
        told = excited.sentences if excited.seconds >= JUDGED_AFTER else []
        yield Review(learned, found, slope, tuple(told))
