"""Posterior of the delay between command and motion."""

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
"""Upper end [s] of the prior of the delay, which begins at 0.

Choice: far above the latency of drives and cameras; a longer one costs evaluations.
"""

UNDETERMINED = 0.15
"""Standard deviation [s] above which the data do not determine the delay.

Choice: half of the standard deviation of the flat prior, 0.29 s.
"""


@dataclass(frozen=True)
class Delay:
    """Delay `value` with standard deviation `std` [s], NaN while the data do not determine it."""

    value: float = 0.0
    std: float = np.nan

    @property
    def determined(self) -> bool:
        """Whether the data determine the delay."""
        return bool(np.isfinite(self.std))

    def felt(self, slope: complex) -> complex:
        """Return the effect of the delay's uncertainty on a quantity.

        Parameters
        ----------
        slope : complex
            Derivative of the quantity by the delay [1/s].

        Returns
        -------
        complex
            Slope times standard deviation. 0 if the delay is undetermined: then a remark says that
            φ depends on it.
        """
        return slope * self.std if self.determined else 0j


def delay_posterior(log_likelihood: Callable[[float], float]) -> Iterator[Delay | None]:
    """Compute the posterior of a delay under a flat prior on [0, LONGEST_DELAY].

    A turn of the command leaves a cusp in the likelihood, not a parabola. Mean and standard
    deviation are therefore integrated over a grid, refined around the mode until it resolves the
    distribution.

    Parameters
    ----------
    log_likelihood : callable
        Profile log likelihood of a delay [s].

    Yields
    ------
    Delay or None
        None after every evaluation, so that a caller with frames to serve can distribute the work;
        the posterior at last.
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
    """Return mean, standard deviation and mode of exp(value), log-linear between points."""
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
    """Fits of one model to one session as functions of the delay of commands.

    Effects that depend on place are evaluated at the session's positions.

    Parameters
    ----------
    model : Model
        The model.
    session : PreparedSession
        The session, with commands as logged.
    """

    def __init__(self, model: Model, session: PreparedSession) -> None:
        self._model = model
        self._session = session
        # Half a frame: the resolution at which the likelihood is smooth.
        self._step = 0.5 * session.interval

    def session(self, delay: float) -> PreparedSession:
        """Return the session with its commands delayed.

        Parameters
        ----------
        delay : float
            Delay [s].

        Returns
        -------
        PreparedSession
            The session.
        """
        commands = self._session.commands
        return replace(self._session, commands=replace(commands, t=commands.t + delay))

    def at(self, delay: float, noise_ratio: float) -> SessionFit:
        """Fit the session for one delay.

        Parameters
        ----------
        delay : float
            Delay [s].
        noise_ratio : float
            σ²/D less a third of the exposure [s].

        Returns
        -------
        SessionFit
            The fit.
        """
        session = self.session(delay)
        expected = ExpectedDisplacement.of(self._model, session.timeline)
        return SessionFit.of(session, Whitening(noise_ratio), expected)

    def posterior(self, noise_ratio: float) -> Iterator[Delay | None]:
        """Compute the posterior of the delay, one evaluation at a time (`delay_posterior`).

        Parameters
        ----------
        noise_ratio : float
            σ²/D less a third of the exposure [s].

        Yields
        ------
        Delay or None
            None after every evaluation, the posterior at last.
        """
        return delay_posterior(lambda delay: self.at(delay, noise_ratio).log_likelihood)

    def log_phasor_slope(self, delay: float, noise_ratio: float) -> complex:
        """Return d log(v e^{iφ}) / d delay, averaged over particles by their information.

        Parameters
        ----------
        delay : float
            Delay [s].
        noise_ratio : float
            σ²/D less a third of the exposure [s].

        Returns
        -------
        complex
            Slope [1/s]; 0 where no particle is driven.
        """
        early, late = (self.at(delay + s, noise_ratio) for s in (-self._step, self._step))
        before, after = early.velocity_phasor, late.velocity_phasor
        weight = early.power * np.abs(before) ** 2
        usable = weight > 0
        if not usable.any():
            return 0j
        slope = (after[usable] / before[usable] - 1) / (2 * self._step)
        return complex(np.average(slope, weights=weight[usable]))
