"""Emulated RoboClaw controllers on one line."""

from __future__ import annotations

import math
import struct

from microbot_ros.drive.amplifiers.roboclaw import codec
from microbot_ros.drive.amplifiers.roboclaw.driver import ADDRESSES
from microbot_ros.drive.emulator.device import Device

_GAP_S = 0.01
"""Gap [s] that discards a packet (user manual, packet serial)."""
_COOL, _HOT = 350, 1005
"""Temperatures in steps of 0.1 °C. Choice: 35 °C, and 100.5 °C, as outputs switch off at 100
°C."""
_LENGTHS = {codec.SET_TIMEOUT: 5, codec.GET_TIMEOUT: 2, codec.GET_VERSION: 2, codec.DRIVE: 8,
            codec.GET_CURRENTS: 2, codec.GET_TEMPERATURE: 2}
"""Length of a whole packet [bytes] by command (user manual); questions are address and command
only."""


class Controllers(Device):
    """Controllers that accept packets without a gap of 10 ms.

    A timeout of 0, as at power-up, is none. Any good packet feeds the timeout. All controllers
    have one timeout here, as the driver sets them alike.
    """

    def reset(self) -> None:
        super().reset()
        self.coils.watchdog_s = None
        self._pending = b''
        self._last_byte_s = 0.0
        self._timeouts = dict.fromkeys(ADDRESSES[:math.ceil(self.coils.channels / 2)], 0)

    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        if now_s - self._last_byte_s > _GAP_S:
            self._pending = b''
        self._last_byte_s = now_s
        self._pending += data
        answers = b''
        while len(self._pending) >= 2:
            address, command = self._pending[:2]
            if address not in self._timeouts or command not in _LENGTHS:
                self._pending = self._pending[1:]
                continue
            if len(self._pending) < (length := _LENGTHS[command]):
                break
            packet, self._pending = self._pending[:length], self._pending[length:]
            answers += self._execute(packet)
        return answers

    def _execute(self, packet: bytes) -> bytes:
        address, command = packet[:2]
        if _LENGTHS[command] == 2:
            answer = codec.answer(packet, self._report(address, command))
        elif packet == codec.packet(address, command, packet[2:-2]):
            self._obey(address, command, packet[2:-2])
            answer = codec.ACKNOWLEDGED
        else:
            return b''
        self.coils.feed()
        return answer

    def _report(self, address: int, command: int) -> bytes:
        if command == codec.GET_VERSION:
            name = b'Sabertooth 2x32' if self.wrong_ports else b'USB Roboclaw 2x15a v4.1.34'
            return name + b'\n\0'
        if command == codec.GET_TIMEOUT:
            return bytes((self._timeouts[address],))
        if command == codec.GET_TEMPERATURE:
            return (_HOT if self.hot else _COOL).to_bytes(2, 'big')
        first = _first_coil(address)
        both = (*self.coils.currents_A, 0.0)[first:first + 2]
        return struct.pack('>hh', *(
            min(max(round(current / codec.CURRENT_STEP_A), -0x8000), 0x7FFF) for current in both))

    def _obey(self, address: int, command: int, data: bytes) -> None:
        if command == codec.SET_TIMEOUT:
            self._timeouts[address] = data[0]
            longest = max(self._timeouts.values())
            self.coils.watchdog_s = longest * codec.TIMEOUT_STEP_S if longest else None
        else:
            scale = self.coils.full_scale_A / codec.FULL_DUTY
            self.coils.command({coil: duty * scale for coil, duty
                                in enumerate(struct.unpack('>hh', data), _first_coil(address))})


def _first_coil(address: int) -> int:
    return 2 * ADDRESSES.index(address)
