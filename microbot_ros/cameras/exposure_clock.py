"""Exposure times on this computer's monotonic clock, from the time stamps of a camera."""

from __future__ import annotations

import math

_DRIFT = 2e-4
"""Choice: crystals are good to 50 ppm; clocks that follow a time server are corrected by more."""
_OLDEST_S = 60.0
"""Choice: a stamp older than this on arrival is from another clock."""


class ExposureClock:
    """Map from a camera's time stamps to this computer's monotonic clock.

    The offset between the clocks is unknown, but no frame arrives before `least_delay` after the
    start of its exposure: the offset is at most the minimum of arrival − `least_delay` − stamp.
    That minimum is kept and may rise by 200 ppm of the elapsed time, so that the clocks may drift
    apart (the clock filter of network time synchronisation: Mills, RFC 5905, where the packet with
    the least delay determines the offset).

    A returned time is therefore never in the future and never before an earlier one. While the
    clocks drift by less than 200 ppm, it is late by at most the extra delay of the fastest recent
    frame. A stamp that is not finite or implausible is ignored: its frame counts as the fastest
    possible. When the device's clock goes back, the offset is determined anew (`restarts` counts
    this).

    Parameters
    ----------
    least_delay : float
        Shortest time from the start of an exposure to the arrival of its frame [s].
    same_clock : bool
        Whether stamps are on this computer's monotonic clock already.
    """

    def __init__(self, least_delay: float = 0.0, same_clock: bool = False) -> None:
        self._least_delay = least_delay
        self._same_clock = same_clock
        self._offset = math.inf
        self._stamp = -math.inf
        self._last = -math.inf
        self.restarts = 0

    def moment(self, stamp: float, arrived: float) -> float:
        """Return the start of an exposure on this computer's clock [s].

        `stamp` is its time on the device's clock [s], `arrived` the arrival of the frame on ours
        [s].

        Parameters
        ----------
        stamp : float
            Time on the device's clock [s].
        arrived : float
            Arrival of the frame on this computer's clock [s].

        Returns
        -------
        float
            Time [s].
        """
        latest = arrived - self._least_delay
        if not math.isfinite(stamp):
            moment = latest
        elif self._same_clock:
            moment = stamp if arrived - _OLDEST_S < stamp <= arrived else latest
        else:
            moment = self._mapped(stamp, latest)
        self._last = max(self._last, moment)
        return self._last

    def _mapped(self, stamp: float, latest: float) -> float:
        since = stamp - self._stamp
        if since < 0:
            self.restarts += 1
            self._offset = math.inf
        self._stamp = stamp
        self._offset = min(latest - stamp, self._offset + _DRIFT * since)
        return min(latest, stamp + self._offset)
