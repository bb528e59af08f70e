"""Sabertooth's packets: address, command, value, and the lowest seven bits of their sum.

An address alone has its highest bit set, so that a packet that was cut ends with the next.
"""

from __future__ import annotations

FULL_DUTY = 127

MOTORS = (0, 4)
"""Command that drives each of the two motors forward; the one after drives it backward."""
SET_TIMEOUT = 14
TIMEOUT_STEP_S = 0.1
BAUDING = b'\xaa'
"""By which older controllers learn the baud rate; newer ones, and every parser, pass over it."""
PACKET_BYTES = 4


def packet(address: int, command: int, value: int) -> bytes:
    """A `command` with a `value` 0 … 127 to the controller at an `address`, which answers nothing.
    """
    body = bytes((address, command, value))
    return body + bytes((sum(body) & 0x7F,))


def drive(address: int, motor: int, duty: float) -> bytes:
    """A `duty` −1 … 1 of a `motor`, 0 or 1, at an `address`."""
    if not -1.0 <= duty <= 1.0:
        raise ValueError(f'duty must be −1 … 1; received {duty}')
    return packet(address, MOTORS[motor] + (duty < 0), round(abs(duty) * FULL_DUTY))


def set_timeout(address: int, seconds: float) -> bytes:
    """Stop both motors at an `address` when no packet came for `seconds`, in steps of 0.1 s."""
    steps = round(seconds / TIMEOUT_STEP_S)
    if not 1 <= steps <= FULL_DUTY:  # a timeout of 0 is none
        raise ValueError(f'timeout must be 0.1 to 12.7 s; received {seconds}')
    return packet(address, SET_TIMEOUT, steps)
