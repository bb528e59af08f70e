"""How late the motion follows the command: a posterior over the delay, not a point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

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
        np.linspace(low, high, 12) for low, high in zip(at[:-1], at[1:], strict=True)
    ]))
    density = np.exp(np.interp(fine, at, value) - value.max())
    mass = np.trapezoid(density, fine)
    mean = np.trapezoid(density * fine, fine) / mass
    return float(mean), float(np.sqrt(np.trapezoid(density * (fine - mean) ** 2, fine) / mass)), mode
