"""The last minute of a few well-seen particles, reviewed with the batch likelihood."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.estimation import excitation
from microbot_ros.estimation.commands import CommandLog, model_paths
from microbot_ros.estimation.delay import Delay, delay_posterior
from microbot_ros.estimation.noise import GainLikelihood, Noise
from microbot_ros.model.model import Model

PROBES = 8
FRAMES = 3000
SECONDS = 60.0
LEAST = 40
"""A review needs at least this many increments."""


@dataclass(frozen=True)
class Review:
    """What a window of data says of the things that all particles share.

    `turn` is d log c / d delay: by how much speed (real part) and φ (imaginary) move with it.
    """

    noise: Noise
    delay: Delay
    turn: complex
    confounded: tuple[str, ...]


class Window:
    """Positions (T, PROBES) of up to PROBES particles over the last SECONDS or FRAMES."""

    def __init__(self) -> None:
        self._t = np.empty(2 * FRAMES)
        self._z = np.full((2 * FRAMES, PROBES), np.nan, complex)
        self._count = 0
        self.ids = np.full(PROBES, -1)
        self._shift = np.zeros(PROBES, complex)

    def add(self, t: float, ids: np.ndarray, z: np.ndarray, used: np.ndarray) -> None:
        """Append a frame: identities (N,), complex positions (N,), which readings count (N,)."""
        if self._count == len(self._t):
            self._t[:FRAMES], self._z[:FRAMES] = self._t[FRAMES:], self._z[FRAMES:]
            self._count = FRAMES
        self._adopt(ids)
        row = np.full(PROBES, np.nan, complex)
        place = {int(name): k for k, name in enumerate(ids)}
        for probe, name in enumerate(self.ids):
            k = place.get(int(name))
            if k is not None and used[k]:
                row[probe] = z[k] - self._shift[probe]
        self._t[self._count], self._z[self._count] = t, row
        self._count += 1

    def _adopt(self, ids: np.ndarray) -> None:
        """Give probes of particles that are gone to particles that are there."""
        alive = np.isin(self.ids, ids)
        if alive.all():
            return
        waiting = iter(np.setdiff1d(ids, self.ids))
        for probe in np.flatnonzero(~alive):
            name = next(waiting, None)
            if name is not None:
                self.ids[probe] = name
                self._shift[probe] = 0
                self._z[:self._count, probe] = np.nan

    def jumped(self, name: int, by: complex) -> None:
        """A particle was moved by `by` [m]: take that out of what follows."""
        self._shift[self.ids == name] += by

    def changed(self, name: int, at: float) -> None:
        """A particle swims differently since `at` [s]: forget what it did before."""
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
        """Noise, delay and excitation, a little at a time; the Review last, or nothing.

        Yields None whenever a caller with frames to serve may want to go on later.
        """
        times, z = self.recent()
        if np.isfinite(z).sum() - PROBES < LEAST:
            return
        commands = log.since(times[0] - 1.0)

        def likelihood(late: float) -> GainLikelihood:
            moved = model_paths(model, replace(commands, t=commands.t + late), times,
                                np.stack([z.real, z.imag], axis=-1))
            drive = np.broadcast_to(moved.drive, z.shape)
            return GainLikelihood(times, z - moved.drift, drive, noise.exposure)

        fit = likelihood(delay.value).maximum()
        yield None
        ratio = fit.noise.localisation**2 / fit.noise.diffusion
        found = Delay()
        if len(commands.t) > 1:
            for result in delay_posterior(lambda d: likelihood(d).at(ratio).log_likelihood):
                yield None
                found = result or found
        in_use = found if found.determined else delay
        step = 0.5 * float(np.median(np.diff(times)))
        early, late = (likelihood(in_use.value + s) for s in (-step, step))
        before, after = early.at(ratio), late.at(ratio)
        turn = _turn(before.gain, after.gain, before.power, 2 * step)
        yield None
        middle, slope = _drive(model, commands, times, in_use.value, step)
        info = excitation.information(times, middle, slope, fit.noise)
        told = excitation.sentences(info, float(times[-1] - times[0]))
        yield Review(fit.noise, found, turn, tuple(told))


def _turn(before: np.ndarray, after: np.ndarray, power: np.ndarray, step: float) -> complex:
    """Mean over particles of d log c / d delay, weighted by what each knows."""
    usable = (power > 0) & (np.abs(before) > 0)
    if not usable.any():
        return 0j
    weight = (power * np.abs(before) ** 2)[usable]
    slope = (after[usable] / before[usable] - 1) / step
    return complex((weight * slope).sum() / weight.sum())


def _drive(
    model: Model, commands: object, times: np.ndarray, delay: float, step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The drive's path of the baseline (T,) and its derivative by the delay (T,)."""
    bare = Model(model.reference_field, model.propulsion)
    early, middle, late = (
        model_paths(bare, replace(commands, t=commands.t + delay + s), times).drive[:, 0]  # type: ignore
        for s in (-step, 0.0, step)
    )
    return middle, (late - early) / (2 * step)
