"""Driver for coil boards that speak SerialTransfer and report their currents by themselves."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from microbot_ros.drive.amplifier import Amplifier
from microbot_ros.drive.errors import NoAnswerError, WrongDeviceError
from microbot_ros.drive.serial_transfer import codec
from microbot_ros.drive.transport import Port

_EXPECTED = 'SerialTransfer packets of six measured currents'
_FIRST_PACKET_S = 1.0  # fifty times the period at which a board reports
_PLAUSIBLE = 2.0  # a reading beyond this part of full scale is damage that the CRC-8 let through


class SerialTransferAmplifier(Amplifier):
    """A coil board on one serial line; duty −1 … 1 is ± `full_scale_A` of each coil.

    `reset_wait_s` is how long the board takes to boot after its port opens: about 2 s for an
    Arduino, 0 for boards (and the emulator) that do not reset. The watchdog is the firmware's
    own; this protocol has no message to arm one.
    """

    def __init__(self, url: str, full_scale_A: float | Sequence[float], *, baud: int = 500_000,
                 reset_wait_s: float = 2.0, tolerance: float = 0.02) -> None:
        super().__init__(url, full_scale_A, tolerance)
        self._baud = baud
        self._reset_wait_s = reset_wait_s
        self._port: Port | None = None
        self._decoder = codec.Decoder(codec.MEASUREMENT_BYTES)

    def _open(self) -> None:
        self._port = Port(self.url, self._baud)
        time.sleep(self._reset_wait_s)
        self._port.discard_input()
        heard = b''
        deadline = time.monotonic() + _FIRST_PACKET_S
        while (left := deadline - time.monotonic()) > 0:
            data = self._port.receive(left)
            if self._decoder.feed(data, time.monotonic()):
                return
            heard += data
        if heard:
            received = f'{len(heard)} bytes: {heard[:12].hex(" ")} …'
            raise WrongDeviceError(self.url, _EXPECTED, received)
        raise NoAnswerError(self.url, _EXPECTED)

    def _send(self, currents_A: np.ndarray) -> None:
        duties = (currents_A / self.full_scale_A).tolist()
        self._require_port().send(codec.encode(codec.command(duties)))
        self.counters.frames_sent += 1

    def _receive(self, timeout_s: float) -> list[tuple[float, np.ndarray]]:
        data = self._require_port().receive(timeout_s)
        now = time.monotonic()
        readings = []
        for payload in self._decoder.feed(data, now):
            currents = np.array(codec.currents(payload)[:4])
            if np.all(np.abs(currents) <= _PLAUSIBLE * self.full_scale_A):
                readings.append((now, currents))
                self.counters.frames_received += 1
            else:
                self._decoder.crc_errors += 1
        self.counters.crc_errors = self._decoder.crc_errors
        self.counters.discarded_bytes = self._decoder.discarded_bytes
        return readings

    def _release(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def _require_port(self) -> Port:
        if self._port is None:
            raise NoAnswerError(self.url, 'a connection')
        return self._port
