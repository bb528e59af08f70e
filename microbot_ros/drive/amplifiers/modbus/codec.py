"""Registers of the H-bridges in Modbus RTU frames, which pymodbus builds and checks."""

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
"""Registers of the bridge (register map of the laboratory's firmware)."""
TEMPERATURES = range(7, 11)
"""Registers of the bridge's temperatures, in steps of 0.01 °C (same register map)."""

# Keep messages on late answers off the terminal; users may add their own handler.
logging.getLogger('pymodbus.logging').addHandler(logging.NullHandler())
_framer = FramerRTU(DecodePDU(is_server=False))
Message = TypeVar('Message', bound=ModbusPDU)


def read(slave: int, register: int, count: int = 1) -> bytes:
    """Return the request for one register, or for several in a row.

    Parameters
    ----------
    slave : int
        Number of the slave.
    register : int
        Number of the first register.
    count : int
        Number of registers.

    Returns
    -------
    bytes
        Bytes of the frame.
    """
    request = ReadHoldingRegistersRequest(address=register, count=count, dev_id=slave)
    return _framer.buildFrame(request)


def write(slave: int, register: int, value: int) -> bytes:
    """Return the request that sets one register, which the slave echoes.

    Parameters
    ----------
    slave : int
        Number of the slave.
    register : int
        Number of the register.
    value : int
        Signed value.

    Returns
    -------
    bytes
        Bytes of the frame.
    """
    bits = value & 0xFFFF
    return _framer.buildFrame(
        WriteSingleRegisterRequest(address=register, registers=[bits], dev_id=slave))


def duty_percent(duty: float) -> int:
    """Return a duty in whole percent, as the register holds it.

    Parameters
    ----------
    duty : float
        Duty from −1 to 1.

    Returns
    -------
    int
        Percent.

    Raises
    ------
    ValueError
        If the duty is outside.
    """
    if not -1.0 <= duty <= 1.0:
        raise ValueError(f'duty must be −1 … 1; received {duty}')
    return round(100 * duty)


def values(slave: int, count: int, received: bytes) -> tuple[int, ...] | None:
    """Return the signed values of registers in a slave's answer.

    Parameters
    ----------
    slave : int
        Number of the slave.
    count : int
        Number of registers.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    tuple of int or None
        None if the answer is incomplete, damaged or of another slave.
    """
    message = _message(slave, received, ReadHoldingRegistersResponse)
    if message is None or len(message.registers) != count:
        return None
    return struct.unpack(f'>{count}h', struct.pack(f'>{count}H', *message.registers))


def written(slave: int, request: bytes, received: bytes) -> bool | None:
    """Return whether a slave echoed a request.

    Parameters
    ----------
    slave : int
        Number of the slave.
    request : bytes
        Bytes of the request.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    bool or None
        True if echoed, else None.
    """
    message = _message(slave, received, WriteSingleRegisterResponse)
    return True if message is not None and received == request else None


def _message(slave: int, received: bytes, kind: type[Message]) -> Message | None:
    try:
        _, message = _framer.handleFrame(received, slave, 0)
    except (ModbusException, struct.error, IndexError):
        return None
    # The framer searches anywhere; accept only a frame without other bytes.
    if not isinstance(message, kind) or _framer.buildFrame(message) != received:
        return None
    return message
