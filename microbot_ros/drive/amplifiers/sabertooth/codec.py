"""Sabertooth's packets: address, command, value, and the lowest seven bits of their sum.

Only an address has its highest bit set, so that a truncated packet ends at the next one.
"""

from __future__ import annotations

FULL_DUTY = 127
"""Value of full output (user manual, packet serial)."""

MOTORS = (0, 4)
"""Command that drives each of the two motors forward; the next command drives it backward (user
manual)."""
SET_TIMEOUT = 14
"""Command that sets the timeout (user manual)."""
TIMEOUT_STEP_S = 0.1
"""Step of the timeout [s] (user manual)."""
BAUDING = b'\xaa'
"""Byte from which older controllers learn the baud rate (user manual); newer ones and every parser
ignore it."""
PACKET_BYTES = 4
"""Length of a packet [bytes] (user manual)."""


def packet(address: int, command: int, value: int) -> bytes:
    """Return a packet with a command, which is not answered.

    Parameters
    ----------
    address : int
        Address of the controller.
    command : int
        Number of the command.
    value : int
        Value from 0 to 127.

    Returns
    -------
    bytes
        Bytes of the packet.
    """
    body = bytes((address, command, value))
    return body + bytes((sum(body) & 0x7F,))


def drive(address: int, motor: int, duty: float) -> bytes:
    """Return the packet that sets a duty.

    Parameters
    ----------
    address : int
        Address of the controller.
    motor : int
        Index of the motor, 0 or 1.
    duty : float
        Duty from −1 to 1.

    Returns
    -------
    bytes
        Bytes of the packet.

    Raises
    ------
    ValueError
        If the duty is outside.
    """
    if not -1.0 <= duty <= 1.0:
        raise ValueError(f'duty must be −1 … 1; received {duty}')
    return packet(address, MOTORS[motor] + (duty < 0), round(abs(duty) * FULL_DUTY))


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

    Raises
    ------
    ValueError
        If the time is not 0.1 to 12.7 s; a timeout of 0 would be none.
    """
    steps = round(seconds / TIMEOUT_STEP_S)
    if not 1 <= steps <= FULL_DUTY:  # a timeout of 0 is none
        raise ValueError(f'timeout must be 0.1 to 12.7 s; received {seconds}')
    return packet(address, SET_TIMEOUT, steps)
