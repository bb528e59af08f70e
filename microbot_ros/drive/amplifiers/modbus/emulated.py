"""Emulated H-bridges, slaves 1, 2, … of one Modbus RTU line."""

from __future__ import annotations

import struct

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteSingleRegisterRequest,
)

from microbot_ros.drive.amplifiers.modbus import codec
from microbot_ros.drive.amplifiers.modbus.driver import EVERY_SLAVE
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.device import Device

_GAP_S = 0.00175
"""Silence [s] that ends a frame above 19 200 baud (Modbus over serial line, 2.5.1.1)."""
_REGISTERS = 11
"""Number of registers, up to the last temperature (register map of the firmware)."""
_COOL, _HOT = 3500, 9500
"""Temperatures in steps of 0.01 °C. Choice: 35 °C, and 95 °C, above the driver's limit."""
_ILLEGAL_ADDRESS = 2
"""Exception code 2, illegal data address (Modbus application protocol, 7)."""


class Bridges(Device):
    """Bridges with registers 0 enable, 1 duty, 5 current, 7 to 10 temperatures; no watchdog.

    Parameters
    ----------
    coils : Coils
        Currents that they drive.
    """

    def __init__(self, coils: Coils) -> None:
        coils.watchdog_s = None
        self._framer = FramerRTU(DecodePDU(is_server=True))
        super().__init__(coils)

    def reset(self) -> None:
        super().reset()
        self._pending = b''
        self._last_byte_s = 0.0
        self._values = {slave: [0] * _REGISTERS for slave
                        in range(1, self.coils.channels + 1)}

    def receive(self, port: int, data: bytes, now_s: float) -> bytes:
        if now_s - self._last_byte_s > _GAP_S:
            self._pending = b''
        self._last_byte_s = now_s
        self._pending += data
        answers = b''
        # Two requests with a proper gap may arrive late, both at once.
        while (request := self._next_request()) is not None:
            answers += self._obey(request)
        return answers

    def _next_request(self) -> ModbusPDU | None:
        try:
            used, request = self._framer.handleFrame(self._pending, 0, 0)
        except (ModbusException, struct.error, IndexError):
            self._pending = b''
            return None
        self._pending = self._pending[used:]
        return request

    def _obey(self, request: ModbusPDU) -> bytes:
        if request.dev_id == EVERY_SLAVE:
            for slave in self._values:
                request.dev_id = slave
                self._answer(request)
            return b''
        if request.dev_id not in self._values:
            return b''
        answer = self._answer(request)
        answer.dev_id = request.dev_id + len(self._values) if self.wrong_ports else request.dev_id
        return self._framer.buildFrame(answer)

    def _answer(self, request: ModbusPDU) -> ModbusPDU:
        values = self._values[request.dev_id]
        end = request.address + max(request.count, 1)
        if isinstance(request, ReadHoldingRegistersRequest) and end <= _REGISTERS:
            current = self.coils.currents_A[request.dev_id - 1]
            shown = min(max(round(current * 1e3), -0x8000), 0x7FFF)  # what the register holds
            values[codec.CURRENT_MA] = shown & 0xFFFF
            for register in codec.TEMPERATURES:
                values[register] = _HOT if self.hot else _COOL
            return ReadHoldingRegistersResponse(registers=values[request.address:end])
        if isinstance(request, WriteSingleRegisterRequest) and end <= _REGISTERS:
            values[request.address] = request.registers[0]
            self._apply(request.dev_id)
            return request
        return ExceptionResponse(request.function_code, _ILLEGAL_ADDRESS)

    def _apply(self, slave: int) -> None:
        values = self._values[slave]
        percent = struct.unpack('>h', values[codec.DUTY_PERCENT].to_bytes(2, 'big'))[0]
        if -100 <= percent <= 100:
            share = percent / 100 if values[codec.ENABLE] == 1 else 0.0
            self.coils.command({slave - 1: share * self.coils.full_scale_A})
