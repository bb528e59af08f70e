"""Joystick of a page: after a silence it counts again only once it was released."""

from __future__ import annotations

import math

_GAP_S = 0.25
"""Silence [s] of a held joystick, which a page reports 20 times a second, after which it must be
released. After it the controller has counted the joystick as centred (`joy_timeout_ms`), and a
position still held must start nothing."""


class Steering:
    """Joystick of one page, and whether its position counts.

    `rested` is whether it was released since it last went silent, or moved without counting.
    """

    def __init__(self) -> None:
        self.rested = True
        self._moving_s = math.inf

    def counts(self, x: float, y: float, now_s: float, allowed: bool) -> bool:
        """Return whether a position of the joystick is passed on.

        Parameters
        ----------
        x, y : float
            Position from −1 to 1.
        now_s : float
            Time [s] at which it was received.
        allowed : bool
            Whether the page may steer.

        Returns
        -------
        bool
            Whether it is passed on.
        """
        if x == y == 0.0:
            self.rested, self._moving_s = True, math.inf
            return allowed
        if not allowed or now_s - self._moving_s > _GAP_S:
            self.rested = False
        self._moving_s = now_s
        return self.rested
