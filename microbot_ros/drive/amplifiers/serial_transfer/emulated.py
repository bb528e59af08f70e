"""Emulated coil board: SerialTransfer in, currents out at 50 Hz and after every command."""

from __future__ import annotations

import math
from collections.abc import Sequence

from microbot_ros.drive.amplifiers.serial_transfer import codec
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.device import Device

_PERIOD_S, _TICK_S = 0.02, 1.024e-3
"""Period of reports (laboratory's firmware) and step of rotating duties (reference firmware)
[s]."""
_Turning = tuple[list[tuple[float, ...]], float]


class Board(Device):
    """Board that decodes duties, holds their currents and reports six measured ones.

    Rotating duties proceed in steps of a millisecond, as in the reference firmware. It reports at
    50 Hz in any case, as the laboratory's firmware does, and in addition immediately after each
    accepted command, so that a host can time the acknowledgement. A packet with a duty outside −1
    … 1, or with a duty for a coil that this board does not have, is not a command: it changes
    nothing and feeds no watchdog.

    Parameters
    ----------
    coils : Coils
        Currents that it drives.
    """

    def __init__(self, coils: Coils) -> None:
        self._turning: _Turning | None = None
        self._turned_s = self._tick_s = self._report_s = 0.0
        super().__init__(coils)

    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        answer = b''
        for packet_id, payload in self._decoder.feed_packets(data, now_s):
            obey = self._turn if packet_id == codec.TURN_ID else self._stand
            if obey(payload, now_s):
                answer += self._report()
        return answer

    def _set(self, duties: Sequence[float] | None, feeds: bool = True) -> bool:
        channels, scale = self.coils.channels, self.coils.full_scale_A
        if duties is None or any(duties[channels:]):
            return False
        self.coils.command([duty * scale for duty in duties[:channels]], feeds)
        return True

    def _stand(self, payload: bytes, _: float) -> bool:
        obeyed = self._set(codec.duties(payload))
        if obeyed:
            self._turning = None
        return obeyed

    def _turn(self, payload: bytes, now_s: float) -> bool:
        turning = codec.turning(payload)
        if turning is None or any(any(part[self.coils.channels:]) for part in turning[0]):
            return False
        self._turning, self._turned_s = turning, now_s
        return self._set(self._turned(turning, now_s))

    def _turned(self, turning: _Turning, now_s: float) -> list[float]:
        """Return the six duties of the rotation at `now_s`."""
        parts, rate = turning
        angle = rate * (now_s - self._turned_s)
        return [steady + cosine * math.cos(angle) + sine * math.sin(angle)
                for steady, cosine, sine in zip(*parts, strict=True)]

    def speak(self, now_s: float) -> bytes:
        if self._turning is not None:
            self._tick_s = now_s + _TICK_S
            if self.coils.watchdog_s is not None and math.isinf(self.coils.due_s()):
                self._turning = None  # the watchdog has ended it
            else:
                self._set(self._turned(self._turning, now_s), feeds=False)
        if now_s < self._report_s:
            return b''
        self._report_s = max(self._report_s + _PERIOD_S, now_s)
        return self._report()

    def due_s(self) -> float:
        return self._report_s if self._turning is None else min(self._report_s, self._tick_s)

    def reset(self) -> None:
        super().reset()
        self._decoder = codec.Decoder(codec.COMMAND_BYTES, (codec.PACKET_ID, codec.TURN_ID))
        self._turning = None

    def _report(self) -> bytes:
        spare = (0.0,) * (codec.COILS - self.coils.channels)
        report = codec.measurement((*self.coils.currents_A, *spare))
        return codec.encode(report[:-4] if self.wrong_ports else report)
