"""Whether this machine had its processors to itself: bounds in milliseconds tell nothing else."""

from __future__ import annotations

import threading
import time
from types import TracebackType

import psutil

_SHARE = 0.05
"""Of all processor time: from which on a failure tells nothing."""

_MOMENT_S = 0.05
"""Of processor time within `_WINDOW_S`: half of what a loop at 60 frames/s may lose at once."""

_LATE_S = 0.1
"""What a driver's deadlines allow a host: one that is later than that is not judged by them."""

_WINDOW_S = 0.25


class Processors:
    """Watches, while it is entered, what the host gives to others.

    A mean alone would not do: 0.2 s taken at once from a run of 40 s are 0.5 %, and enough for an
    amplifier to end the currents by itself.
    """

    share = 0.0
    """Of all processor time since it was entered."""

    longest_s = 0.0
    """The most of processor time that was taken within a quarter of a second."""

    late_s = 0.0
    """By how much the watch woke up late, whoever had the processors."""

    def __enter__(self) -> Processors:
        self._begin = self._last = psutil.cpu_times()
        self._ended = threading.Event()
        self._watch = threading.Thread(target=self._look_on, daemon=True)
        self._watch.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._ended.set()
        self._watch.join()
        self._look()
        # What guests take is in the first two as well.
        spent = sum(self._last[:8]) - sum(self._begin[:8])
        self.share = (self._last.steal - self._begin.steal) / spent if spent else 0.0

    def _look_on(self) -> None:
        began = time.monotonic()
        while not self._ended.wait(_WINDOW_S):
            self._look()
            now = time.monotonic()
            self.late_s = max(self.late_s, now - began - _WINDOW_S)
            began = now

    def _look(self) -> None:
        now = psutil.cpu_times()
        self.longest_s = max(self.longest_s, now.steal - self._last.steal)
        self._last = now

    @property
    def ours(self) -> bool:
        """Whether a failure in this time tells of the code, not of the machine."""
        return (self.share < _SHARE and self.longest_s < _MOMENT_S
                and self.late_s < _LATE_S)

    def __str__(self) -> str:
        return (f'{self.share:.0%} of processors stolen, {1e3 * self.longest_s:.0f} ms at once; '
                f'{1e3 * self.late_s:.0f} ms late')
