"""How late the motion follows the command: a posterior over the delay, not a point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from microbot_ros.estimation.commands import model_paths
from microbot_ros.estimation.excitation import Excitation, judge
from microbot_ros.estimation.noise import GainLikelihood, Noise
from microbot_ros.model.model import Model
from microbot_ros.records import Commands

LONGEST_DELAY = 1.0
"""Delays are looked for between 0 and this [s]."""

UNDETERMINED = 0.15
"""With a standard deviation above this [s] the data do not determine the delay."""


@dataclass(frozen=True)
class Delay:
    """Delay [s] with its standard deviation; `std` NaN while the data do not determine it."""

    value: float = 0.0
    std: float = np.nan

    @property
    def determined(self) -> bool:
        """Whether the data determine it."""
        return bool(np.isfinite(self.std))


def delay_posterior(log_likelihood: Callable[[float], float]) -> Iterator[Delay | None]:
    """Evaluate the profile likelihood of a delay a little at a time; last, yield the Delay.

    Under a flat prior on [0, LONGEST_DELAY]. A turn of the command leaves a cusp in the
    likelihood, not a parabola, so mean and spread are integrated over a grid that is refined
    around the mode until it resolves the spread. Yields None after every evaluation, so that a
    caller with frames to serve can spread the work.
    """
    grid = np.linspace(0, LONGEST_DELAY, 21)
    known: dict[float, float] = {}
    while True:
        for delay in grid:
            if float(delay) not in known:
                known[float(delay)] = log_likelihood(float(delay))
                yield None
        at = np.array(sorted(known))
        mean, std, mode = _moments(at, np.array([known[d] for d in at]))
        step = float(np.diff(grid).min())
        if std > 1.2 * step or step < 2e-4:
            break
        # At most 0.6 of the spacing before, so this ends.
        reach = max(step, 4 * std)
        grid = np.unique(np.clip(np.linspace(mode - reach, mode + reach, 17), 0, LONGEST_DELAY))
    yield Delay(mean, std if std < UNDETERMINED else np.nan)


def _moments(at: np.ndarray, value: np.ndarray) -> tuple[float, float, float]:
    """Mean and standard deviation of exp(value), linear in the logarithm between points; mode."""
    mode = float(at[np.argmax(value)])
    fine = np.unique(np.concatenate([
        np.linspace(low, high, 12) for low, high in pairwise(at)
    ]))
    density = np.exp(np.interp(fine, at, value) - value.max())
    mass = np.trapezoid(density, fine)
    mean = np.trapezoid(density * fine, fine) / mass
    variance = np.trapezoid(density * (fine - mean) ** 2, fine) / mass
    return float(mean), float(np.sqrt(variance)), mode


class DelayedLikelihood:
    """The likelihood of a stretch of record as a function of the delay, under one model.

    `times` (T,) [s]; `z` (T, N) complex positions [m], NaN for gaps. Effects that depend on
    place are taken at the positions given.
    """

    def __init__(
        self, model: Model, commands: Commands, times: np.ndarray, z: np.ndarray,
        exposure: float,
    ) -> None:
        self._model = model
        self._commands = commands
        self._times = times
        self._z = z
        self._exposure = exposure
        # Half a frame: the resolution at which the likelihood is smooth.
        self._step = 0.5 * float(np.median(np.diff(times)))

    def at(self, delay: float) -> GainLikelihood:
        """The likelihood of gains and noise for one delay [s]."""
        positions = np.stack([self._z.real, self._z.imag], axis=-1)
        moved = model_paths(self._model, self._late(delay), self._times, positions)
        drive = np.broadcast_to(moved.drive, self._z.shape)
        return GainLikelihood(self._times, self._z - moved.drift, drive, self._exposure)

    def drive(self, delay: float) -> np.ndarray:
        """The accumulated drive (T, 1 or N) at one delay [s]."""
        positions = np.stack([self._z.real, self._z.imag], axis=-1)
        return model_paths(self._model, self._late(delay), self._times, positions).drive

    def delay(self, noise: Noise) -> Iterator[Delay | None]:
        """The posterior of the delay, an evaluation at a time (see `delay_posterior`)."""
        ratio = noise.localisation**2 / noise.diffusion
        return delay_posterior(lambda delay: self.at(delay).at(ratio).log_likelihood)

    def turn(self, delay: float, noise: Noise) -> complex:
        """d log c / d delay [1/s], averaged over particles by what each knows."""
        ratio = noise.localisation**2 / noise.diffusion
        early, late = (self.at(delay + s).at(ratio) for s in (-self._step, self._step))
        usable = (early.power > 0) & (np.abs(early.gain) > 0)
        if not usable.any():
            return 0j
        weight = (early.power * np.abs(early.gain) ** 2)[usable]
        slope = (late.gain[usable] / early.gain[usable] - 1) / (2 * self._step)
        return complex((weight * slope).sum() / weight.sum())

    def excitation(self, delay: float, noise: Noise) -> Excitation:
        """What the command could tell apart."""
        bare = Model(self._model.reference_field, self._model.propulsion)
        early, middle, late = (
            model_paths(bare, self._late(delay + s), self._times).drive[:, 0]
            for s in (-self._step, 0.0, self._step)
        )
        slope = (late - early) / (2 * self._step)
        return judge(self._times, middle, slope, noise)

    def _late(self, delay: float) -> Commands:
        return replace(self._commands, t=self._commands.t + delay)
