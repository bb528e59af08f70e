"""What every emulated amplifier does with a command: hold currents, guard them, log changes."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from typing import TextIO


class Coils:
    """Currents of so many `channels` within ±`full_scale_A` that change at once, and the watchdog
    that zeroes them.

    Every change is one line of JSON in `log`, flushed: `t_monotonic_s`, `currents_A`, `cause`.
    `watchdog_s` is how long after the last good command the currents go to zero; None models
    firmware that keeps them for ever; `clock` counts seconds.
    """

    def __init__(self, full_scale_A: float, watchdog_s: float | None, log: TextIO,
                 clock: Callable[[], float] = time.monotonic, channels: int = 4) -> None:
        self.channels = channels
        self.full_scale_A = full_scale_A
        self.watchdog_s = watchdog_s
        self.currents_A: tuple[float, ...] = ()
        """What flows, and is measured."""
        self._wanted: list[float] = [0.0] * channels
        self._shares: tuple[float, ...] = (1.0,) * channels
        self._log = log
        self._clock = clock
        self._deadline_s = math.inf
        self.zero('reset')

    def command(self, wanted_A: dict[int, float] | Sequence[float], feeds: bool = True) -> None:
        """Take `wanted_A` [A], of some coils, by index, or of all.

        That `feeds` the watchdog where a host has asked for it. A channel without a coil carries
        nothing.
        """
        if feeds:
            self.feed()
        for coil, current in dict(wanted_A if isinstance(wanted_A, dict)
                                  else enumerate(wanted_A)).items():
            if coil < self.channels:
                self._wanted[coil] = current
        self._settle('command')

    def feed(self) -> None:
        """Start the watchdog's time anew."""
        if self.watchdog_s is not None:
            self._deadline_s = self._clock() + self.watchdog_s

    def zero(self, cause: str) -> None:
        """Zero for a reason other than a command; the watchdog rests until the next command."""
        self._deadline_s = math.inf
        self._wanted = [0.0] * self.channels
        self._settle(cause)

    def conduct(self, shares: tuple[float, ...], cause: str) -> None:
        """Let each coil carry its part in `shares` of its current until told otherwise: 0 where
        its wire is broken, −1 where it is reversed.
        """
        if shares != self._shares:
            self._shares = shares
            self._settle(cause)

    def due_s(self) -> float:
        """When the watchdog will zero the currents [s, monotonic]; inf where it rests."""
        return self._deadline_s

    def watch(self, now_s: float) -> None:
        """Zero the currents if the watchdog's time is over at `now_s`."""
        if now_s >= self._deadline_s:
            self.zero('watchdog')

    def _settle(self, cause: str) -> None:
        # Adding zero makes −0, which a log should not show, 0.
        currents = tuple(share * wanted + 0.0
                         for share, wanted in zip(self._shares, self._wanted, strict=True))
        if currents == self.currents_A:
            return
        self.currents_A = currents
        entry = {'t_monotonic_s': self._clock(), 'currents_A': currents, 'cause': cause}
        self._log.write(json.dumps(entry) + '\n')
        self._log.flush()
