"""Moments of exposure on this computer's monotonic clock, from the stamps of a camera."""

from __future__ import annotations

import math

_DRIFT = 2e-4
"""Crystals are good to 50 ppm; clocks that follow a time server are turned by some more."""
_OLDEST_S = 60.0
"""A frame that has been on its way for longer has a stamp of another clock."""


class ExposureClock:
    """When exposures began, from what a device's clock said and when their frames arrived.

    A device's clock runs at an offset from ours that is not known, but no frame arrives before
    `least_delay` [s] after its exposure began: the offset is at most the least of arrival −
    `least_delay` − stamp. That minimum is kept, and allowed to rise by 200 ppm of the time that
    passes, so that clocks may drift apart. (Taken from synchronisation over networks, where the
    packet with the least delay tells the offset: Mills, RFC 5905, clock filter.)

    So a moment is never in the future, never before one that was given earlier, and, while the
    clocks drift by less than that, at most as late as the fastest frame lately was on its way
    beyond `least_delay`. Where `same_clock`, the stamps are on our clock already. A stamp that is
    NaN, infinite or of no sense is none: the frame is taken for as fast as can be. A device's
    clock that goes back has been set anew, and so is the offset (`restarts` counts).
    """

    def __init__(self, least_delay: float = 0.0, same_clock: bool = False) -> None:
        self._least_delay = least_delay
        self._same_clock = same_clock
        self._offset = math.inf
        self._stamp = -math.inf
        self._last = -math.inf
        self.restarts = 0

    def moment(self, stamp: float, arrived: float) -> float:
        """When the exposure began [s, ours], by the device's `stamp` of it [s, its own]; its frame
        `arrived` at [s, ours]."""
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
