"""How late the motion follows the command: a posterior over the delay, not a point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import SessionFit, Whitening
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.model.model import Model

LONGEST_DELAY = 1.0
"""Delays are looked for between 0 and this [s]."""

UNDETERMINED = 0.15
"""With a standard deviation above this [s] the data do not determine the delay."""


@dataclass(frozen=True)
class Delay:
    """Delay `value` [s] with standard deviation `std`, NaN while the data do not determine it."""

    value: float = 0.0
    std: float = np.nan

    @property
    def determined(self) -> bool:
        """Whether the data determine it."""
        return bool(np.isfinite(self.std))

    def felt(self, slope: complex) -> complex:
        """What its spread does to a quantity with that `slope` [1/s]; nothing where undetermined.

        Then it is said that φ hangs on it.
        """
        return slope * self.std if self.determined else 0j


def delay_posterior(log_likelihood: Callable[[float], float]) -> Iterator[Delay | None]:
    """Evaluate the profile `log_likelihood` of a delay [s] a little at a time; last, the Delay.

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
    # The trapezoid rule, by hand: importing scipy.integrate would take a node 0.1 s.
    steps = np.diff(fine)
    weight = density * (np.append(steps, 0.0) + np.insert(steps, 0, 0.0))
    weight /= weight.sum()
    mean = weight @ fine
    variance = weight @ (fine - mean) ** 2
    return float(mean), float(np.sqrt(variance)), mode


class DelayedFits:
    """Fits of one `model` to one `session` as functions of how late commands act.

    Effects that depend on place are taken at the session's positions.
    """

    def __init__(self, model: Model, session: PreparedSession) -> None:
        self._model = model
        self._session = session
        # Half a frame: the resolution at which the likelihood is smooth.
        self._step = 0.5 * session.interval

    def session(self, delay: float) -> PreparedSession:
        """The session with its commands that `delay` [s] later."""
        commands = self._session.commands
        return replace(self._session, commands=replace(commands, t=commands.t + delay))

    def at(self, delay: float, noise_ratio: float) -> SessionFit:
        """The fit for one `delay` [s] and `noise_ratio` [s]."""
        session = self.session(delay)
        expected = ExpectedDisplacement.of(self._model, session.timeline)
        return SessionFit.of(session, Whitening(noise_ratio), expected)

    def posterior(self, noise_ratio: float) -> Iterator[Delay | None]:
        """That of the delay under a `noise_ratio` [s], an evaluation at a time.

        See `delay_posterior`.
        """
        return delay_posterior(lambda delay: self.at(delay, noise_ratio).log_likelihood)

    def log_phasor_slope(self, delay: float, noise_ratio: float) -> complex:
        """d log(v e^{iφ}) / d delay [1/s] at a `delay` [s] under a `noise_ratio` [s].

        Averaged over particles by what each knows; 0 where none is driven.
        """
        early, late = (self.at(delay + s, noise_ratio) for s in (-self._step, self._step))
        before, after = early.velocity_phasor, late.velocity_phasor
        weight = early.power * np.abs(before) ** 2
        usable = weight > 0
        if not usable.any():
            return 0j
        slope = (after[usable] / before[usable] - 1) / (2 * self._step)
        return complex(np.average(slope, weights=weight[usable]))
