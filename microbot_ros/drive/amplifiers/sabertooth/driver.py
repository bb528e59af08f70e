"""Driver for Sabertooth controllers on one line, with two coils each.

Coils 1 and 2 are at address 0x80, 3 and 4 at 0x81, and so on. The controllers send nothing,
neither currents nor acknowledgements: their state cannot be checked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle

import numpy as np

from microbot_ros.drive.amplifier import COILS, Amplifier, Command, Watchdog, Zero
from microbot_ros.drive.amplifiers.sabertooth import codec

ADDRESSES = range(0x80, 0x88)
"""Addresses of the controllers, each of which has two channels (user manual)."""
_BAUD = 9_600  # default of the controllers (user manual)
_BYTE_S = 10 / _BAUD
"""Time of a byte on the line [s]: 10 bits (8N1)."""
_LATEST_S = 0.07
"""Longest time [s] until the next packet after one was sent. Choice: the refresh of commands (40
ms), with room for a busy machine."""


class SabertoothAmplifier(Amplifier):
    """Controllers whose duty −1 … 1 is ± `full_scale_A` of each coil.

    The full scale is the supply's voltage over the coil's resistance, cold or hot, and is not
    measured.

    A controller forgets its timeout when it loses power and cannot be asked for it, so every
    command repeats it to one of them. At 9600 baud the commands of four coils take 21 ms: the
    newest is sent when the line has transmitted the one before.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    full_scale_A : float or sequence of float
        Current of each coil at full output [A]; a scalar applies to all coils.
    channels : int
        Number of coils N.
    """

    watchdog = Watchdog.UNCONFIRMED
    reads_back = False

    def __init__(self, url: str, full_scale_A: float | Sequence[float],
                 channels: int = len(COILS)) -> None:
        super().__init__(url, full_scale_A, channels)
        self._addresses = ADDRESSES[:-(-channels // 2)]
        self._turns = cycle(self._addresses)
        self.sample_s = _BYTE_S * (len(self._zeros()[0]) + codec.PACKET_BYTES)
        steps = -(-(self.sample_s + _LATEST_S) // codec.TIMEOUT_STEP_S)
        self.timeout_s = float(steps * codec.TIMEOUT_STEP_S)
        """Time [s] without a packet after which the controllers stop."""
        self._order: Command | None  # the newest command, until it is sent
        self._flowing: bool
        self._free_s: float  # time at which all bytes are transmitted

    def _open(self) -> None:
        self._order, self._flowing, self._free_s = None, False, -math.inf
        self._lines.append(self._open_port(self.url, _BAUD))
        self._say(codec.BAUDING + self._zeros()[0] + b''.join(
            codec.set_timeout(address, self.timeout_s) for address in self._addresses))

    def _end(self) -> Zero:
        self._flowing = True  # send the last zero at once, not when the line is free
        return super()._end()

    def _send(self, command: Command) -> None:
        self._require_lines()
        flows = bool(np.any(command.currents_A))
        if self._flowing and not flows:
            self._lines[0].discard_output()  # controllers ignore a truncated packet
            self._order = None
            self._say(*self._zeros())
        else:
            self._order = command
            self._go_on()
        self._flowing = flows
        self.counters.frames_sent += 1

    def _receive(self, timeout_s: float) -> list[tuple[float, float, np.ndarray]]:
        """Return no readings; send the waiting command as soon as the line is free."""
        self._require_lines()
        until_s = self.clock.now() + timeout_s
        while not self._woken.is_set() and (now := self.clock.now()) < until_s:
            next_s = until_s if self._order is None else min(self._free_s, until_s)
            self.clock.wait(self._woken, next_s - now)
            self._go_on()
        self._woken.clear()
        return []

    def _go_on(self) -> None:
        if self._order is not None and self.clock.now() >= self._free_s:
            currents, self._order = self._order.currents_A, None
            self._say(codec.set_timeout(next(self._turns), self.timeout_s)
                      + self._drive((currents / self.full_scale_A).tolist()))

    def _say(self, data: bytes) -> None:
        self._lines[0].send(data)
        self._free_s = self.clock.now() + _BYTE_S * len(data)

    def _zeros(self) -> list[bytes]:
        return [self._drive([0.0] * self.channels)]

    def _drive(self, duties: list[float]) -> bytes:
        return b''.join(codec.drive(self._addresses[channel // 2], channel % 2, duty)
                        for channel, duty in enumerate(duties))
