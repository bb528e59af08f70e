"""A stick as the server hears it: what went silent counts again only once it was let go."""

from __future__ import annotations

import math

_GAP_S = 0.25
"""A page says 20 times a second where a stick is that is held. After such a silence the controller
has counted it as centred (`joy_timeout_ms`), and what is still held is to start nothing."""


class Steering:
    """The stick of one page: whether what it says counts.

    `rested`: whether it was let go since it last went silent, or spoke without counting.
    """

    def __init__(self) -> None:
        self.rested = True
        self._moving_s = math.inf

    def counts(self, x: float, y: float, now_s: float, allowed: bool) -> bool:
        """Whether a stick at `x`, `y`, heard at `now_s` [s] of a page that is `allowed` to steer
        or not, is to be passed on."""
        if x == y == 0.0:
            self.rested, self._moving_s = True, math.inf
            return allowed
        if not allowed or now_s - self._moving_s > _GAP_S:
            self.rested = False
        self._moving_s = now_s
        return self.rested
