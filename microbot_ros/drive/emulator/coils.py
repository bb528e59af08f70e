"""Common part of emulated amplifiers: hold currents, guard them, log changes."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from typing import TextIO


class Coils:
    """Currents that change at once, within ±`full_scale_A`, and the watchdog that zeroes them.

    Every change is one line of JSON in the log, flushed: `t_monotonic_s`, `currents_A`, `cause`.

    Parameters
    ----------
    full_scale_A : float
        Largest current [A].
    watchdog_s : float or None
        Time [s] after the last valid command at which the currents go to zero; None models
        firmware that keeps them indefinitely.
    log : TextIO
        File of the log.
    clock : callable
        Function that returns the time [s].
    channels : int
        Number of coils N.
    """

    def __init__(self, full_scale_A: float, watchdog_s: float | None, log: TextIO,
                 clock: Callable[[], float] = time.monotonic, channels: int = 4) -> None:
        self.channels = channels
        self.full_scale_A = full_scale_A
        self.watchdog_s = watchdog_s
        self.currents_A: tuple[float, ...] = ()
        """Currents (N,) [A] that flow, and are measured."""
        self._wanted: list[float] = [0.0] * channels
        self._shares: tuple[float, ...] = (1.0,) * channels
        self._log = log
        self._clock = clock
        self._deadline_s = math.inf
        self.zero('reset')

    def command(self, wanted_A: dict[int, float] | Sequence[float], feeds: bool = True) -> None:
        """Set currents and, if requested, feed the watchdog.

        Parameters
        ----------
        wanted_A : dict of int to float or sequence of float
            Currents [A] of some coils by index, or of all. A channel without a coil carries
            nothing.
        feeds : bool
            Whether the command feeds the watchdog, if a host has enabled it.
        """
        if feeds:
            self.feed()
        for coil, current in dict(wanted_A if isinstance(wanted_A, dict)
                                  else enumerate(wanted_A)).items():
            if coil < self.channels:
                self._wanted[coil] = current
        self._settle('command')

    def feed(self) -> None:
        """Restart the watchdog's time."""
        if self.watchdog_s is not None:
            self._deadline_s = self._clock() + self.watchdog_s

    def zero(self, cause: str) -> None:
        """Zero for a reason other than a command; the watchdog is idle until the next command.

        Parameters
        ----------
        cause : str
            Reason, for the log.
        """
        self._deadline_s = math.inf
        self._wanted = [0.0] * self.channels
        self._settle(cause)

    def conduct(self, shares: tuple[float, ...], cause: str) -> None:
        """Set the share of its current that each coil carries.

        Parameters
        ----------
        shares : tuple of float, shape (N,)
            0 for a broken wire, −1 for a reversed coil; they hold until changed.
        cause : str
            Reason, for the log.
        """
        if shares != self._shares:
            self._shares = shares
            self._settle(cause)

    def due_s(self) -> float:
        """Return the time at which the watchdog will zero the currents.

        Returns
        -------
        float
            Time [s] of the monotonic clock; inf if it is idle.
        """
        return self._deadline_s

    def watch(self, now_s: float) -> None:
        """Zero the currents if the watchdog's time has passed.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.
        """
        if now_s >= self._deadline_s:
            self.zero('watchdog')

    def _settle(self, cause: str) -> None:
        # Adding zero converts −0, which a log should not show, to 0.
        currents = tuple(share * wanted + 0.0
                         for share, wanted in zip(self._shares, self._wanted, strict=True))
        if currents == self.currents_A:
            return
        self.currents_A = currents
        entry = {'t_monotonic_s': self._clock(), 'currents_A': currents, 'cause': cause}
        self._log.write(json.dumps(entry) + '\n')
        self._log.flush()
