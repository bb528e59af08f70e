"""Whether this machine had its processors to itself: bounds in milliseconds tell nothing else."""

from __future__ import annotations

import psutil

STOLEN = 0.05
"""Share of the processors that another machine took, from which on a failure tells nothing."""


class Processors:
    """Counts from when it is made."""

    def __init__(self) -> None:
        self._before = psutil.cpu_times()

    @property
    def stolen(self) -> float:
        """The share of all processor time since then that the host gave to others."""
        now = psutil.cpu_times()
        # What guests take is in the first two as well.
        spent = sum(now[:8]) - sum(self._before[:8])
        return (now.steal - self._before.steal) / spent if spent else 0.0
