"""The emulated coil board: SerialTransfer in, currents at 50 Hz and after every command out."""

from __future__ import annotations

from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.device import Device
from microbot_ros.drive.serial_transfer import codec

_PERIOD_S = 0.02


class Board(Device):
    """Decodes duties, holds the currents they mean, reports six measured, for `coils`.

    It reports at 50 Hz whatever happens, as the laboratory's firmware does, and besides at once
    after each command it accepts, so that a host can time the acknowledgement. A packet with a
    duty that is not within −1 … 1, or with one for a coil that this board has not, is not a
    command: it changes nothing and feeds no watchdog.
    """

    def __init__(self, coils: Coils) -> None:
        super().__init__(coils)
        self._due_s = 0.0

    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        answer = b''
        for payload in self._decoder.feed(data, now_s):
            duties = codec.duties(payload)
            channels = self.coils.channels
            if duties is not None and not any(duties[channels:]):
                scale = self.coils.full_scale_A
                self.coils.command([duty * scale for duty in duties[:channels]])
                answer += self._report()
        return answer

    def speak(self, now_s: float) -> bytes:
        self._due_s = max(self._due_s + _PERIOD_S, now_s)
        return self._report()

    def due_s(self) -> float:
        return self._due_s

    def reset(self) -> None:
        super().reset()
        self._decoder = codec.Decoder(codec.COMMAND_BYTES)

    def _report(self) -> bytes:
        spare = (0.0,) * (codec.COILS - self.coils.channels)
        report = codec.measurement((*self.coils.currents_A, *spare))
        return codec.encode(report[:-4] if self.wrong_device else report)
