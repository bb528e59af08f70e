"""RoboClaw's packets: address, command, data, and a CRC-16 (0x1021, initial value 0) over all."""

from __future__ import annotations

import struct
from binascii import crc_hqx

ACKNOWLEDGED = b'\xff'
FULL_DUTY = 32767

SET_TIMEOUT, GET_TIMEOUT, GET_VERSION = 14, 15, 21
DRIVE, GET_CURRENTS, GET_TEMPERATURE = 34, 49, 82
TIMEOUT_STEP_S = 0.1
CURRENT_STEP_A = 0.01
TEMPERATURE_STEP_C = 0.1
_LONGEST_VERSION = 48


def packet(address: int, command: int, data: bytes = b'') -> bytes:
    """A `command` with `data` to the controller at an `address`; it is answered with FF."""
    body = bytes((address, command)) + data
    return body + crc_hqx(body, 0).to_bytes(2, 'big')


def drive(address: int, first: float, second: float) -> bytes:
    """Duties −1 … 1 of motors 1 (`first`) and 2 (`second`) at an `address`, taken at once."""
    return packet(address, DRIVE, struct.pack('>hh', _steps(first), _steps(second)))


def _steps(duty: float) -> int:
    if not -1.0 <= duty <= 1.0:
        raise ValueError(f'duty must be −1 … 1; received {duty}')
    return round(duty * FULL_DUTY)


def set_timeout(address: int, seconds: float) -> bytes:
    """Stop both motors at an `address` when no packet came for `seconds`, in steps of 0.1 s."""
    return packet(address, SET_TIMEOUT, bytes((round(seconds / TIMEOUT_STEP_S),)))


def ask_timeout(address: int) -> bytes:
    """Asks an `address` for the timeout. Questions carry no CRC; their answers do."""
    return bytes((address, GET_TIMEOUT))


def ask_version(address: int) -> bytes:
    """Asks an `address` for the name and version of the firmware."""
    return bytes((address, GET_VERSION))


def ask_currents(address: int) -> bytes:
    """Asks an `address` for the currents of both motors."""
    return bytes((address, GET_CURRENTS))


def ask_temperature(address: int) -> bytes:
    """Asks an `address` for the temperature of the board."""
    return bytes((address, GET_TEMPERATURE))


def answer(question: bytes, data: bytes) -> bytes:
    """What a controller answers: data and the CRC of question and data together."""
    return data + crc_hqx(question + data, 0).to_bytes(2, 'big')


def timeout(question: bytes, received: bytes) -> float | None:
    """The timeout [s] `received` as answer to a `question`; None where incomplete or damaged."""
    data = _data(question, received, 1)
    return None if data is None else data[0] * TIMEOUT_STEP_S


def currents(question: bytes, received: bytes) -> tuple[float, float] | None:
    """The currents [A] `received` as answer to a `question`; None where incomplete or damaged."""
    data = _data(question, received, 4)
    if data is None:
        return None
    first, second = struct.unpack('>hh', data)
    return first * CURRENT_STEP_A, second * CURRENT_STEP_A


def temperature(question: bytes, received: bytes) -> float | None:
    """The temperature [°C] `received` as answer to a `question`; None where incomplete or damaged.
    """
    data = _data(question, received, 2)
    return None if data is None else int.from_bytes(data, 'big') * TEMPERATURE_STEP_C


def version(question: bytes, received: bytes) -> str | None:
    """The text `received` as answer to a `question`, up to line feed and zero; None where damaged.
    """
    end = received.find(b'\n\0')
    if not 0 <= end < _LONGEST_VERSION:
        return None
    data = _data(question, received, end + 2)
    return None if data is None else data[:-2].decode('ascii', 'replace')


def _data(question: bytes, received: bytes, length: int) -> bytes | None:
    data = received[:length]
    return data if received == answer(question, data) and len(data) == length else None
