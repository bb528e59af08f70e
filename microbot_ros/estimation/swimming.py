"""How a particle swims while nothing holds it, and whether something is in its way now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FEWEST = 60
"""Fewest steps from which it is known how a particle swims. Choice: six seconds; half takes the
noise of few steps for small."""

SPREAD, KNOWN = 0.3, 10.0
"""Smallest variance of commands relative to their mean square, and smallest ratio (`KNOWN`) of c
to its standard deviation.

Choice: with one command only a flow and c are not told apart; a c known to a third makes every
speed one that is too low.
"""

BLOCK = 10
"""Steps of a sum whose variance counts as noise, if it exceeds that of as many single steps.

Choice: a second, about the time for which headings lag.
"""

INEXACT = 0.05
"""Smallest standard deviation of a step, relative to its length. Choice: no model is closer."""

OTHER = 4.0
"""Log-likelihood by which an arbitrary other c must fit better than a wall.

Choice: it has two numbers and a wall one; at half of it walls are lost, at twice every other c is
a wall."""

SLOWED = 0.3
"""Fraction of its speed below which a particle stands. Choice: a speed rarely falls as far."""


@dataclass(frozen=True)
class Swimming:
    """How a particle moves: steps are `c` times those for v e^{iφ} = 1, plus a flow, and noise.

    Attributes
    ----------
    c : complex
        v e^{iφ}.
    flow : complex
        Steps by an unknown flow [m].
    variance : float
        Variance of a step, per axis [m²].
    """

    c: complex
    flow: complex
    variance: float

    @classmethod
    def of(cls, steps: np.ndarray, swum: np.ndarray) -> Swimming | None:
        """Fit to steps.

        Parameters
        ----------
        steps : ndarray of complex, shape (T,)
            Steps [m].
        swum : ndarray of complex, shape (T,)
            Expected steps for v e^{iφ} = 1.

        Returns
        -------
        Swimming or None
            None for fewer than FEWEST steps, for commands in about one direction, and where noise
            leaves c unknown.
        """
        if len(steps) < FEWEST:
            return None
        ways = swum - swum.mean()
        power = _square(ways)
        if power <= SPREAD * _square(swum):
            return None
        c = complex(np.vdot(ways, steps) / power)
        flow = complex((steps - c * swum).mean())
        rest = steps - c * swum - flow
        sums = rest[:len(rest) // BLOCK * BLOCK].reshape(-1, BLOCK).sum(axis=1)
        variance = max(_square(rest) / len(rest), _square(sums) / len(sums) / BLOCK,
                       (INEXACT * abs(c)) ** 2 * power / len(steps)) / 2
        if power * abs(c) ** 2 <= KNOWN**2 * variance:
            return None
        return cls(c, flow, variance)

    def is_blocked(self, steps: np.ndarray, swum: np.ndarray, margin: float) -> bool:
        """Return whether something is in the way of a particle that swims like this.

        A wall takes the part of the motion into it: the particle slides along, or stands. That
        must fit better than the same c, a c of another direction and a lower speed, and about as
        well as any other c.

        Parameters
        ----------
        steps : ndarray of complex, shape (T,)
            Steps [m].
        swum : ndarray of complex, shape (T,)
            Expected steps for v e^{iφ} = 1, not all 0.
        margin : float
            Log-likelihood by which it must fit better.

        Returns
        -------
        bool
            Also False if both fit equally and `margin` is 0.
        """
        other = response(steps - self.flow, swum)
        turned = other * abs(self.c) / abs(other) if other else self.c
        slower = max((other / self.c).real, 0.0)
        swims = [self.c, turned, slower * self.c if slower > SLOWED else self.c]
        wall = min(self._misfit(steps), self._misfit(steps - self._along_a_wall(steps, swum)))
        same = min(self._misfit(steps - c * swum - flow)
                   for c in swims for flow in (self.flow, 0))
        any_other = self._misfit(steps - other * swum - self.flow)
        return wall < min(same - margin, any_other + OTHER)

    def _along_a_wall(self, steps: np.ndarray, swum: np.ndarray) -> np.ndarray:
        """Return the steps (T,) [m] along the wall that fits best.

        Along a wall of direction w, an expected step e becomes Re(e w*) w = (e + w² e*) / 2, so
        that w² is found by linear regression.
        """
        expected = self.c * swum + self.flow
        square = np.sum(expected * (2 * steps - expected))
        normal = 1j * np.sqrt(square / abs(square)) if square else 1j
        into = (expected / normal).real
        if into.sum() < 0:
            normal, into = -normal, -into
        return expected - normal * np.maximum(into, 0)

    def _misfit(self, rest: np.ndarray) -> float:
        return _square(rest) / (2 * self.variance)


def response(steps: np.ndarray, swum: np.ndarray) -> complex:
    """Return the c that fits best.

    Parameters
    ----------
    steps : ndarray of complex, shape (T,)
        Steps [m].
    swum : ndarray of complex, shape (T,)
        Expected steps for v e^{iφ} = 1, not all 0.

    Returns
    -------
    complex
        The least-squares solution of steps = c swum.
    """
    return complex(np.vdot(swum, steps) / np.vdot(swum, swum))


def _square(x: np.ndarray) -> float:
    """Return the sum of |x|²."""
    return float(np.vdot(x, x).real)
