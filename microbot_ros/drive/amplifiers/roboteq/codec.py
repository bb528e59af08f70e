"""Roboteq's text protocol: lines that end with CR; commands are answered with + or −."""

from __future__ import annotations

import re

FULL_COMMAND = 1000
"""Command of full output (user manual, command G)."""
CURRENT_STEP_A = 0.1
"""Step of the reported currents [A] (user manual, query A)."""
END = b'\r'

_FAULTS = ('overheat', 'overvoltage', 'undervoltage', 'short circuit', 'emergency stop',
           'sensor or setup fault', 'MOSFET failure')
"""Bits of the fault flags, lowest first (user manual, query FF). Bit 7 reports that the default
configuration was loaded; higher bits differ between models."""
_FLAGS = re.compile(rb'\d{1,5}')
_VALUES = re.compile(rb'(-?\d{1,5}):(-?\d{1,5})')


def drive(first: float, second: float) -> bytes:
    """Return the commands of channels 1 and 2.

    Parameters
    ----------
    first, second : float
        Command from −1 to 1.

    Returns
    -------
    bytes
        Bytes of both lines.

    Raises
    ------
    ValueError
        If a command is outside.
    """
    if not all(-1.0 <= share <= 1.0 for share in (first, second)):
        raise ValueError(f'commands must be −1 … 1; received {first}, {second}')
    return b''.join(line(f'!G {channel} {round(share * FULL_COMMAND)}')
                    for channel, share in ((1, first), (2, second)))


def line(text: str) -> bytes:
    """Return one command or query as a line.

    Parameters
    ----------
    text : str
        The command.

    Returns
    -------
    bytes
        Bytes with the end of the line.
    """
    return text.encode('ascii') + END


def accepted(count: int, received: bytes) -> bool | None:
    """Return whether commands were accepted.

    Parameters
    ----------
    count : int
        Number of commands.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    bool or None
        True if all were accepted; None if the answer is incomplete or a command was refused.
    """
    return True if received == (b'+' + END) * count else None


def text(name: str, received: bytes) -> str | None:
    """Return the text after `name=` in an answer.

    Parameters
    ----------
    name : str
        Name of the query.
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    str or None
        None if the answer is incomplete or belongs to another query.
    """
    prefix = name.encode('ascii') + b'='
    content, end, rest = received.partition(END)
    if not end or rest or not content.startswith(prefix):
        return None
    return content.removeprefix(prefix).decode('ascii', 'replace')


def faults(received: bytes) -> tuple[str, ...] | None:
    """Return the faults in an answer to `?FF`.

    Parameters
    ----------
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    tuple of str or None
        Names of the faults; None if the answer is incomplete or damaged.
    """
    content = text('FF', received)
    if content is None or not _FLAGS.fullmatch(content.encode()):
        return None
    return tuple(name for bit, name in enumerate(_FAULTS) if int(content) >> bit & 1)


def currents(received: bytes) -> tuple[float, float] | None:
    """Return the currents of both channels in an answer.

    Parameters
    ----------
    received : bytes
        Bytes that arrived so far.

    Returns
    -------
    tuple[float, float] or None
        Currents [A]; None if the answer is incomplete or damaged.
    """
    content = text('A', received)
    match = _VALUES.fullmatch(content.encode()) if content is not None else None
    if match is None:
        return None
    return int(match[1]) * CURRENT_STEP_A, int(match[2]) * CURRENT_STEP_A
