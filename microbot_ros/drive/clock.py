"""Time as the drive uses it: one object that tests replace by a virtual one."""

from __future__ import annotations

import threading
import time


class Clock:
    """The clock of this machine, and the two ways to wait on it.

    `CoilDriver` and the amplifier drivers read time and wait through this object alone, so that a
    test can run them on virtual time.
    """

    def now(self) -> float:
        """Return the time since boot [s], which goes on while the machine is suspended.

        CLOCK_MONOTONIC would stand still then: a command from before would not be stale after.
        """
        return time.clock_gettime(time.CLOCK_BOOTTIME)

    def sleep(self, seconds: float) -> None:
        """Wait for `seconds` [s]; return at once where they are not above 0."""
        if seconds > 0.0:
            time.sleep(seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Wait until `event` is set, `seconds` [s] at most; return whether it is set."""
        return event.wait(max(seconds, 0.0))
