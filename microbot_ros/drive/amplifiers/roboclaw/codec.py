"""RoboClaw's packets: address, command, data, and a CRC-16 (0x1021, initial value 0) over all."""

from __future__ import annotations

import struct
from binascii import crc_hqx

ACKNOWLEDGED = b'\xff'
"""Answer to a command (user manual, packet serial)."""
FULL_DUTY = 32767
"""Value of full output (user manual, command 34)."""

SET_TIMEOUT, GET_TIMEOUT, GET_VERSION = 14, 15, 21
"""Numbers of commands (user manual, packet serial)."""
DRIVE, GET_CURRENTS, GET_TEMPERATURE = 34, 49, 82
"""Numbers of commands (user manual, packet serial)."""
TIMEOUT_STEP_S = 0.1
"""Step of the timeout [s] (user manual, command 14)."""
CURRENT_STEP_A = 0.01
"""Step of the reported currents [A] (user manual, command 49)."""
TEMPERATURE_STEP_C = 0.1
"""Step of the reported temperature [°C] (user manual, command 82)."""
_LONGEST_VERSION = 48
"""Longest version text [bytes] (user manual, command 21)."""


def packet(address: int, command: int, data: bytes = b'') -> bytes:
    """Return a packet with a command, which is answered with FF.

    Parameters
    ----------
    address : int
        Address of the controller.
    command : int
        Number of the command.
    data : bytes
        Data of the command.

    Returns
    -------
    bytes
        Bytes of the packet.
    """
    body = bytes((address, command)) + data
    return body + crc_hqx(body, 0).to_bytes(2, 'big')


def drive(address: int, first: float, second: float) -> bytes:
    """Return the packet that sets the duties of motors 1 and 2, effective at once.

    Parameters
    ----------
    address : int
        Address of the controller.
    first, second : float
        Duty from −1 to 1.

    Returns
    -------
    bytes
        Bytes of the packet.

    Raises
    ------
    ValueError
        If a duty is outside.
    """
    return packet(address, DRIVE, struct.pack('>hh', _steps(first), _steps(second)))


def _steps(duty: float) -> int:
    if not -1.0 <= duty <= 1.0:
        raise ValueError(f'duty must be −1 … 1; received {duty}')
    return round(duty * FULL_DUTY)


def set_timeout(address: int, seconds: float) -> bytes:
    """Return the packet that makes both motors stop if no packet arrives for some time.

    Parameters
    ----------
    address : int
        Address of the controller.
    seconds : float
        Time [s], rounded to steps of 0.1 s.

    Returns
    -------
    bytes
        Bytes of the packet.
    """
    return packet(address, SET_TIMEOUT, bytes((round(seconds / TIMEOUT_STEP_S),)))


def ask(address: int, command: int) -> bytes:
    """Return a question. Questions carry no CRC; their answers do.

    Parameters
    ----------
    address : int
        Address of the controller.
    command : int
        Command that asks: `GET_TIMEOUT`, `GET_VERSION`, `GET_CURRENTS` or `GET_TEMPERATURE`.

    Returns
    -------
    bytes
        Bytes of the question.
    """
    return bytes((address, command))


def answer(question: bytes, data: bytes) -> bytes:
    """Return a controller's answer: data and the CRC of question and data together.

    Parameters
    ----------
    question : bytes
        Bytes of the question.
    data : bytes
        Data of the answer.

    Returns
    -------
    bytes
        Bytes of the answer.
    """
    return data + crc_hqx(question + data, 0).to_bytes(2, 'big')


def timeout(question: bytes, received: bytes) -> float | None:
    """Return the timeout in an answer.

    Parameters
    ----------
    question : bytes
        Bytes of the question.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    float or None
        Time [s]; None if the answer is incomplete or damaged.
    """
    data = _data(question, received, 1)
    return None if data is None else data[0] * TIMEOUT_STEP_S


def currents(question: bytes, received: bytes) -> tuple[float, float] | None:
    """Return the currents of both motors in an answer.

    Parameters
    ----------
    question : bytes
        Bytes of the question.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    tuple[float, float] or None
        Currents [A]; None if the answer is incomplete or damaged.
    """
    data = _data(question, received, 4)
    if data is None:
        return None
    first, second = struct.unpack('>hh', data)
    return first * CURRENT_STEP_A, second * CURRENT_STEP_A


def temperature(question: bytes, received: bytes) -> float | None:
    """Return the temperature in an answer.

    Parameters
    ----------
    question : bytes
        Bytes of the question.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    float or None
        Temperature [°C]; None if the answer is incomplete or damaged.
    """
    data = _data(question, received, 2)
    return None if data is None else int.from_bytes(data, 'big') * TEMPERATURE_STEP_C


def version(question: bytes, received: bytes) -> str | None:
    """Return the version text in an answer, up to line feed and zero.

    Parameters
    ----------
    question : bytes
        Bytes of the question.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    str or None
        None if the answer is incomplete or damaged.
    """
    end = received.find(b'\n\0')
    if not 0 <= end < _LONGEST_VERSION:
        return None
    data = _data(question, received, end + 2)
    return None if data is None else data[:-2].decode('ascii', 'replace')


def _data(question: bytes, received: bytes, length: int) -> bytes | None:
    data = received[:length]
    return data if received == answer(question, data) and len(data) == length else None
