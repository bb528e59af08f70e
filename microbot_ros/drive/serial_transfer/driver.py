"""Driver for coil boards that speak SerialTransfer and report their currents by themselves."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from microbot_ros.drive.amplifier import COILS, Amplifier, Command, Watchdog
from microbot_ros.drive.errors import NoAnswerError, WrongDeviceError
from microbot_ros.drive.serial_transfer import codec
from microbot_ros.drive.transport import Port

_EXPECTED = 'SerialTransfer packets of six measured currents'
_RUNNING_S = 0.035  # two periods: longer than a board that opening the port resets lives on
_BITS, _ROOM = 10, 1.25  # of a byte on the line; a quarter of it stays free
_PACKET_BYTES = len(codec.encode(codec.command([])))
_STRAY = 0.1  # of full scale: more than the noise of a sense line
_PLAUSIBLE = 2.0  # a reading beyond this part of full scale is damage that the CRC-8 let through


class SerialTransferAmplifier(Amplifier):
    """A coil board on the serial line `url` at `baud`; duty −1 … 1 is ± `full_scale_A` of each of
    up to six `channels`.

    Opening the port resets an Arduino, which takes 2 s to boot; others run on. The driver is
    connected when packets have kept coming, and gives up after `boot_s`. The watchdog is the
    firmware's own; this protocol has no message to arm one.
    """

    watchdog = Watchdog.FIRMWARE
    can_swing = True

    most_channels = codec.COILS

    def __init__(self, url: str, full_scale_A: float | Sequence[float],
                 channels: int = len(COILS), *, baud: int = 500_000, boot_s: float = 3.0) -> None:
        super().__init__(url, full_scale_A, channels)
        self._baud = baud
        self.sample_s = max(self.sample_s, _ROOM * _BITS * _PACKET_BYTES / baud)
        self._boot_s = boot_s
        self._port: Port | None = None
        self._decoder = codec.Decoder(codec.MEASUREMENT_BYTES)

    def _open(self) -> None:
        self._port = Port(self.url, self._baud)
        deadline = time.monotonic() + self._boot_s
        heard, first = b'', None
        while (left := deadline - time.monotonic()) > 0:
            data = self._port.receive(left)
            now = time.monotonic()
            if self._decoder.feed(data, now):
                first = first or now
                if now - first >= _RUNNING_S:
                    return
            heard += data
        if heard:
            received = f'{len(heard)} bytes: {heard[:12].hex(" ")} …'
            raise WrongDeviceError(self.url, _EXPECTED, received)
        raise NoAnswerError(self.url, _EXPECTED)

    def wake(self) -> None:
        if (port := self._port) is not None:
            port.wake()

    def last_words(self) -> list[tuple[int, bytes]]:
        descriptor = self._require_port().descriptor
        zero = codec.encode(codec.command([0.0] * self.channels))
        return [] if descriptor is None else [(descriptor, zero)]

    def _send(self, command: Command) -> None:
        if (swing := command.swing) is not None:
            parts = [(part / self.full_scale_A).tolist()
                     for part in (swing.steady, swing.cosine, swing.sine)]
            packet = codec.encode(codec.turn(parts, swing.rate), codec.TURN_ID)
        else:
            duties = (command.currents_A / self.full_scale_A).tolist()
            packet = codec.encode(codec.command(duties))
        self._require_port().send(packet)
        self.counters.frames_sent += 1

    def _receive(self, timeout_s: float) -> list[tuple[float, float, np.ndarray]]:
        data = self._require_port().receive(timeout_s)
        now = time.monotonic()
        readings = []
        for payload in self._decoder.feed(data, now):
            currents = np.array(codec.currents(payload))
            if np.all(np.abs(currents) <= _PLAUSIBLE * self.full_scale_A.max()):
                readings.append((now, now, currents[:self.channels]))
                self.fault = self._stray(currents[self.channels:])
                self.counters.frames_received += 1
            else:
                self._decoder.crc_errors += 1
        self.counters.crc_errors = self._decoder.crc_errors
        self.counters.discarded_bytes = self._decoder.discarded_bytes
        return readings

    def _stray(self, currents_A: np.ndarray) -> str:
        """What is wrong with the coils that are never driven; '' for nothing."""
        stray = [f'coil {1 + self.channels + index} carries {current:.2g} A, and was never told to'
                 for index, current in enumerate(currents_A.tolist())
                 if not abs(current) <= _STRAY * self.full_scale_A.max()]
        return '; '.join(stray)

    def _release(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def _require_port(self) -> Port:
        if self._port is None:
            raise NoAnswerError(self.url, 'a connection')
        return self._port
