"""Clock of the drive: one object that tests replace by a virtual one."""

from __future__ import annotations

import threading
import time


class Clock:
    """Clock of this machine, and the two ways to wait on it.

    `CoilDriver` and the amplifier drivers read time and wait through this object alone, so that a
    test can run them on virtual time.
    """

    def now(self) -> float:
        """Return the time since boot, which continues while the machine is suspended.

        CLOCK_MONOTONIC would stop during suspension: a command from before would not be stale
        after it.

        Returns
        -------
        float
            Time [s].
        """
        return time.clock_gettime(time.CLOCK_BOOTTIME)

    def sleep(self, seconds: float) -> None:
        """Wait; return at once if the time is not above 0.

        Parameters
        ----------
        seconds : float
            Time [s].
        """
        if seconds > 0.0:
            time.sleep(seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Wait until an event is set.

        Parameters
        ----------
        event : threading.Event
            Event to wait for.
        seconds : float
            Longest time to wait [s].

        Returns
        -------
        bool
            Whether the event is set.
        """
        return event.wait(max(seconds, 0.0))
