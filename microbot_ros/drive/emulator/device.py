"""The contract between an emulated amplifier and the terminal that it sits behind."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from microbot_ros.drive.emulator.coils import Coils


class Device(ABC):
    """An amplifier of some `coils` as its bytes show it: no clock of its own, no port, no file."""

    channels_per_port = 0
    """How many channels a serial line serves; 0 for all."""

    def __init__(self, coils: Coils) -> None:
        self.coils = coils
        self.ports = math.ceil(coils.channels / (self.channels_per_port or coils.channels))
        """How many serial lines it has."""
        self.wrong_ports: frozenset[int] = frozenset()
        """The lines on which it answers as another model would."""
        self.hot = False
        """Whether it is too hot to drive: no current flows, and it says so where it can."""
        self.reset()

    @abstractmethod
    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        """Take `data` that came in on a `port` at `now_s`; the answer to send back on it."""

    def speak(self, now_s: float) -> bytes:
        """What the device says by itself at `now_s`, on its first line."""
        return b''

    def due_s(self) -> float:
        """When it next speaks by itself [s, monotonic]; inf for never."""
        return math.inf

    def reset(self) -> None:
        """Forget half-received bytes and every setting, as at power-up, with zero currents."""
        self.coils.zero('reset')
