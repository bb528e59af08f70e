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
"""Number of particles in the window. Choice: a review costs time in proportion."""

FRAMES = 3000
"""Largest number of frames in the window. Choice: 60 s at 50 frames per second."""

SECONDS = 60.0
"""Longest span of the window [s]. Choice: noise and delay hardly change in it."""

LEAST = 40
"""Fewest increments for a review. Choice: noise levels are then known to 20 %."""

JUDGED_AFTER = 3.0
"""Time [s] of data before a review reports what the command does not distinguish.

Choice: a command of fewer seconds has hardly begun to turn.
"""


@dataclass(frozen=True)
class Review:
    """Result of a review: what a window of data determines of what all particles share.

    Attributes
    ----------
    noise : Noise
        Fitted noise.
    delay : Delay
        Fitted delay.
    log_phasor_slope : complex
        d log(v e^{iφ}) / d delay [1/s]: change of speed (real part) and φ (imaginary part).
    confounded : tuple of str
        Sentences on what the command does not distinguish.
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
        """Each present probe, and its row among the present particles."""

    def add(self, t: float, ids: np.ndarray, z: np.ndarray, used: np.ndarray) -> None:
        """Append a frame.

        Parameters
        ----------
        t : float
            Time [s].
        ids : ndarray of int, shape (N,)
            Particles.
        z : ndarray of complex, shape (N,)
            Positions [m].
        used : ndarray of bool, shape (N,)
            Which positions are used.
        """
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
        """Give the probes of particles that left to particles that are present."""
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
        """Subtract a displacement of a particle from its later positions.

        Parameters
        ----------
        name : int
            The particle.
        by : complex
            Distance by which it was moved [m].
        """
        self._shift[self.ids == name] += by

    def changed(self, name: int, at: float) -> None:
        """Forget the past of a particle whose motion changed.

        Parameters
        ----------
        name : int
            The particle.
        at : float
            Time of the change [s].
        """
        before = self._t[:self._count] < at
        self._z[:self._count][np.ix_(before, self.ids == name)] = np.nan

    def recent(self) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the times and positions of the window.

        Returns
        -------
        times : ndarray, shape (T,)
            Times [s].
        z : ndarray of complex, shape (T, PROBES)
            Positions [m]; NaN in gaps.
        """
        first = max(self._count - FRAMES, 0)
        times = self._t[first:self._count]
        first += int(np.searchsorted(times, times[-1] - SECONDS)) if len(times) else 0
        kept = slice(first, self._count)
        return self._t[kept].copy(), self._z[kept].copy()

    def review(
        self, model: Model, log: CommandLog, delay: Delay, noise: Noise,
    ) -> Iterator[Review | None]:
        """Fit noise, delay and excitation to the window, a little at a time.

        Parameters
        ----------
        model : Model
            Model of the filter.
        log : CommandLog
            Commands.
        delay : Delay
            Delay in use.
        noise : Noise
            Noise in use.

        Yields
        ------
        Review or None
            None where a caller with frames to serve may continue later; the review at last.
            Nothing for too few frames.
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
