"""Contract between an emulated amplifier and its terminal."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from microbot_ros.drive.emulator.coils import Coils


class Device(ABC):
    """Emulated amplifier at the level of its bytes: no clock of its own, no port, no file.

    Parameters
    ----------
    coils : Coils
        Currents that it drives.
    """

    channels_per_port = 0
    """Number of channels that a serial line serves; 0 for all."""

    def __init__(self, coils: Coils) -> None:
        self.coils = coils
        self.ports = math.ceil(coils.channels / (self.channels_per_port or coils.channels))
        """Number of its serial lines."""
        self.wrong_ports: frozenset[int] = frozenset()
        """Lines on which it answers like another model."""
        self.hot = False
        """Whether it is too hot to drive: no current flows, and it reports so if it can."""
        self.reset()

    @abstractmethod
    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        """Process bytes that arrived on a line and return the answer.

        Parameters
        ----------
        port : int
            Index of the line, from 0.
        data : bytes
            Bytes that arrived.
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        bytes
            Bytes to send back on the line.
        """

    def speak(self, now_s: float) -> bytes:
        """Return the bytes that the device sends unasked on its first line.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        bytes
            Bytes; b'' for none.
        """
        return b''

    def due_s(self) -> float:
        """Return the time at which it next sends unasked.

        Returns
        -------
        float
            Time [s] of the monotonic clock; inf for never.
        """
        return math.inf

    def reset(self) -> None:
        """Discard half-received bytes and every setting, as at power-up, with zero currents."""
        self.coils.zero('reset')
