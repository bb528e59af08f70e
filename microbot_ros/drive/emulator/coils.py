"""What every emulated amplifier does with a command: hold currents, guard them, log changes."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from typing import TextIO


class Coils:
    """Four currents [A] that change at once, and the watchdog that zeroes them.

    Every change is one line of JSON in `log`, flushed: `t_monotonic_s`, `currents_A`, `cause`.
    `watchdog_s` is how long after the last good command the currents go to zero; None models
    firmware that keeps them for ever.
    """

    def __init__(self, full_scale_A: float, watchdog_s: float | None, log: TextIO) -> None:
        self.full_scale_A = full_scale_A
        self.watchdog_s = watchdog_s
        self.currents_A: tuple[float, ...] = ()
        self._log = log
        self._deadline_s = math.inf
        self.zero('reset')

    def command(self, currents_A: Sequence[float]) -> None:
        """Take currents from a good command and feed the watchdog."""
        self.feed()
        self._set(tuple(currents_A), 'command')

    def feed(self) -> None:
        """Start the watchdog's time anew."""
        if self.watchdog_s is not None:
            self._deadline_s = time.monotonic() + self.watchdog_s

    def zero(self, cause: str) -> None:
        """Zero for a reason other than a command; the watchdog rests until the next command."""
        self._deadline_s = math.inf
        self._set((0.0,) * 4, cause)

    def due_s(self) -> float:
        """When the watchdog will zero the currents [s, monotonic]; inf where it rests."""
        return self._deadline_s

    def watch(self, now_s: float) -> None:
        """Zero the currents if the watchdog's time is over."""
        if now_s >= self._deadline_s:
            self.zero('watchdog')

    def _set(self, currents_A: tuple[float, ...], cause: str) -> None:
        if currents_A == self.currents_A:
            return
        self.currents_A = currents_A
        entry = {'t_monotonic_s': time.monotonic(), 'currents_A': currents_A, 'cause': cause}
        self._log.write(json.dumps(entry) + '\n')
        self._log.flush()
