"""Driver for coil boards that speak SerialTransfer and report their currents unasked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ros.drive.amplifier import AGAIN_S, COILS, Amplifier, Command, Watchdog
from microbot_ros.drive.amplifiers.serial_transfer import codec
from microbot_ros.drive.errors import NoAnswerError, WrongDeviceError

_EXPECTED = 'SerialTransfer packets of six measured currents'
_RUNNING_S = 0.035
"""Time [s] that packets must keep coming: two periods of 50 Hz less a margin, longer than a board
that opening the port resets continues to send."""
_BITS, _ROOM = 10, 1.25
"""Bits per byte on the line (8N1), and the factor that keeps a fifth of its capacity free
(choice)."""
_PACKET_BYTES = len(codec.encode(codec.command([])))
_STRAY = 0.1
"""Current of an unused coil, as a part of full scale, above which it is a fault. Choice: more than
the noise of a sense line."""
_PLAUSIBLE = 2.0
"""Reading, as a part of full scale, beyond which it counts as damage that the CRC-8 missed.
Choice: twice what the board can give."""


class SerialTransferAmplifier(Amplifier):
    """Coil board whose duty −1 … 1 is ± `full_scale_A` of each of up to six coils.

    Opening the port resets an Arduino, which takes 2 s to boot; other boards keep running. The
    driver is connected when packets have kept coming. The watchdog belongs to the firmware; this
    protocol has no message to arm one.

    Parameters
    ----------
    url : str
        Device name or pyserial URL of the port.
    full_scale_A : float or sequence of float
        Current of each coil at full output [A]; a scalar applies to all coils.
    channels : int
        Number of coils N.
    baud : int
        Rate of the line [1/s].
    boot_s : float
        Time [s] after which connecting fails.
    """

    watchdog = Watchdog.FIRMWARE
    report_age_s = 0.025
    """Longest age of a report [s]: a packet on the line (1 ms), the delay of a USB adapter (16 ms
    by default), and room for a busy machine. A board reports unasked, with the values of that
    time."""
    network_age_s = 0.25
    """The same where the port is a URL. Choice: a hundred milliseconds each way, and room."""
    can_swing = True

    most_channels = codec.COILS

    def __init__(self, url: str, full_scale_A: float | Sequence[float],
                 channels: int = len(COILS), *, baud: int = 500_000, boot_s: float = 3.0) -> None:
        super().__init__(url, full_scale_A, channels)
        self._baud = baud
        if '://' in url:
            self.report_age_s = self.network_age_s
        self.sample_s = max(self.sample_s, _ROOM * _BITS * _PACKET_BYTES / baud)
        self._boot_s = boot_s
        self._decoder = codec.Decoder(codec.MEASUREMENT_BYTES)

    def _open(self) -> None:
        port = self._open_port(self.url, self._baud)
        self._lines.append(port)
        now = zeroed = self.clock.now()
        if self._known:
            port.send(*self._zeros())
        deadline = now + self._boot_s
        heard, first = b'', None
        while (left := deadline - self.clock.now()) > 0:
            data = port.receive(min(left, AGAIN_S))
            now = self.clock.now()
            if self._known and now - zeroed >= AGAIN_S:
                zeroed = now
                port.send(*self._zeros())
            if self._decoder.feed(data, now):
                first = first or now
                if now - first >= _RUNNING_S:
                    return
            heard += data
        if heard:
            received = f'{len(heard)} bytes: {heard[:12].hex(" ")} …'
            raise WrongDeviceError(self.url, _EXPECTED, received)
        raise NoAnswerError(self.url, _EXPECTED)

    def _zeros(self) -> list[bytes]:
        return [codec.encode(codec.command([0.0] * self.channels))]

    def _send(self, command: Command) -> None:
        if (swing := command.swing) is not None:
            parts = [(part / self.full_scale_A).tolist()
                     for part in (swing.steady, swing.cosine, swing.sine)]
            packet = codec.encode(codec.turn(parts, swing.rate), codec.TURN_ID)
        else:
            duties = (command.currents_A / self.full_scale_A).tolist()
            packet = codec.encode(codec.command(duties))
        self._require_lines()
        self._lines[0].send(packet)
        self.counters.frames_sent += 1

    def _receive(self, timeout_s: float) -> list[tuple[float, float, np.ndarray]]:
        self._require_lines()
        data = self._lines[0].receive(timeout_s)
        now = self.clock.now()
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
        """Return the fault of coils that are never driven; '' for none."""
        stray = [f'spare channel {1 + self.channels + index} carries {current:.2g} A; no coil is '
                 'configured on it'
                 for index, current in enumerate(currents_A.tolist())
                 if not abs(current) <= _STRAY * self.full_scale_A.max()]
        return '; '.join(stray)
