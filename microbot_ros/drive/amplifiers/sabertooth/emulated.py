"""Emulated Sabertooth controllers on one line."""

from __future__ import annotations

import math

from microbot_ros.drive.amplifiers.sabertooth import codec
from microbot_ros.drive.amplifiers.sabertooth.driver import ADDRESSES
from microbot_ros.drive.emulator.device import Device

_MOTOR_COMMANDS = {forward + back: (motor, -1.0 if back else 1.0)
                   for motor, forward in enumerate(codec.MOTORS) for back in (0, 1)}
"""Motor and sign by command; all values are from the codec."""


class Controllers(Device):
    """Controllers that accept packets with a correct checksum and never answer.

    Other bytes may lie between the packets. Any good packet feeds the timeout. All controllers
    have one timeout here, as the driver sets them alike; at power-up there is none. Another model
    ignores all packets.
    """

    def reset(self) -> None:
        super().reset()
        self.coils.watchdog_s = None
        self._pending = b''
        self._timeouts = dict.fromkeys(ADDRESSES[:math.ceil(self.coils.channels / 2)], 0)

    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        for byte in data:
            # An address begins a packet, also within another.
            self._pending = bytes((byte,)) if byte > codec.FULL_DUTY else (
                self._pending + bytes((byte,)) if self._pending else b'')
            if len(self._pending) == codec.PACKET_BYTES:
                packet, self._pending = self._pending, b''
                self._take(packet)
        return b''

    def _take(self, packet: bytes) -> None:
        address, command, value, check = packet
        if self.wrong_ports or address not in self._timeouts or (
                check != (address + command + value) % 128):
            return
        if command in _MOTOR_COMMANDS:
            motor, sign = _MOTOR_COMMANDS[command]
            coil = 2 * ADDRESSES.index(address) + motor
            share = sign * value / codec.FULL_DUTY
            self.coils.command({coil: share * self.coils.full_scale_A})
        elif command == codec.SET_TIMEOUT:
            self._timeouts[address] = value
            longest = max(self._timeouts.values())
            self.coils.watchdog_s = longest * codec.TIMEOUT_STEP_S if longest else None
            self.coils.feed()
