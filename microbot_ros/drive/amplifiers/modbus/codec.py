"""The registers of the H-bridges in Modbus RTU frames, which pymodbus builds and checks."""

from __future__ import annotations

import logging
import struct
from typing import TypeVar

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)

ENABLE, DUTY_PERCENT, CURRENT_MA = 0, 1, 5
TEMPERATURES = range(7, 11)
"""Registers of the bridge's temperatures, in steps of 0.01 °C."""

# A late answer is nothing for the terminal; who wants to hear of it has a handler of their own.
logging.getLogger('pymodbus.logging').addHandler(logging.NullHandler())
_framer = FramerRTU(DecodePDU(is_server=False))
Message = TypeVar('Message', bound=ModbusPDU)


def read(slave: int, register: int, count: int = 1) -> bytes:
    """Asks a slave for one register, or for `count` in a row."""
    request = ReadHoldingRegistersRequest(address=register, count=count, dev_id=slave)
    return _framer.buildFrame(request)


def write(slave: int, register: int, value: int) -> bytes:
    """Sets one register of a slave to a signed value, which the slave repeats."""
    bits = value & 0xFFFF
    return _framer.buildFrame(
        WriteSingleRegisterRequest(address=register, registers=[bits], dev_id=slave))


def duty_percent(duty: float) -> int:
    """A duty of −1 … 1 in the whole percents that the register holds; ValueError outside."""
    if not -1.0 <= duty <= 1.0:
        raise ValueError(f'duty must be −1 … 1; received {duty}')
    return round(100 * duty)


def values(slave: int, count: int, received: bytes) -> tuple[int, ...] | None:
    """The signed values of `count` registers in a slave's answer `received`; None where
    incomplete, damaged or another's.
    """
    message = _message(slave, received, ReadHoldingRegistersResponse)
    if message is None or len(message.registers) != count:
        return None
    return struct.unpack(f'>{count}h', struct.pack(f'>{count}H', *message.registers))


def written(slave: int, request: bytes, received: bytes) -> bool | None:
    """True where a slave repeated the request in `received`; None otherwise."""
    message = _message(slave, received, WriteSingleRegisterResponse)
    return True if message is not None and received == request else None


def _message(slave: int, received: bytes, kind: type[Message]) -> Message | None:
    try:
        _, message = _framer.handleFrame(received, slave, 0)
    except (ModbusException, struct.error, IndexError):
        return None
    # The framer looks for a frame anywhere; only one that is all there is may pass.
    if not isinstance(message, kind) or _framer.buildFrame(message) != received:
        return None
    return message
