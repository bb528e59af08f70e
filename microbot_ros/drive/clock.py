"""Time as the drive uses it: one object that tests replace by a virtual one."""

from __future__ import annotations

import threading
import time


class Clock:
    """The clocks of this machine, and the two ways to wait on them.

    `CoilDriver` and the amplifier drivers read time and wait through this object alone, so that a
    test can run them on virtual time.
    """

    def now(self) -> float:
        """Return the monotonic time [s], which stands still while the machine is suspended."""
        return time.monotonic()

    def suspended(self) -> float:
        """Return how long [s] the machine has been suspended since it was booted."""
        return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait for `seconds` [s]; return at once where they are not above 0."""
        if seconds > 0.0:
            time.sleep(seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Wait until `event` is set, `seconds` [s] at most; return whether it is set."""
        return event.wait(max(seconds, 0.0))
