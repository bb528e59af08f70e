"""Lines of SCPI for a bipolar supply, and the numbers that it returns."""

from __future__ import annotations

import re

CLEAR_INPUT = b'\x1b'
"""ESC, which empties the supply's input buffer (Kepco's manual of the BIT 232 interface)."""
LONGEST_LINE = 253
"""Most characters of a line; more overflow the supply's buffer (same manual)."""

_OVER_TEMPERATURE = 0b11000
"""Bits of the questionable condition: bit 3 in Kepco's BIT 232 interface, bit 4 in the SCPI-1999
standard."""
_NUMBER = re.compile(rb'[+-]?\d{1,30}(\.\d*)?(E[+-]?\d{1,2})?')


def line(*commands: str) -> bytes:
    """Return commands as one line.

    Parameters
    ----------
    *commands : str
        Commands, without separators.

    Returns
    -------
    bytes
        The line with its end.

    Raises
    ------
    ValueError
        If the line is longer than `LONGEST_LINE`.
    """
    text = ';'.join(commands).encode('ascii') + b'\n'
    if len(text) > LONGEST_LINE:
        raise ValueError(f'a line must be at most {LONGEST_LINE} bytes; received {len(text)}')
    return text


def current(amperes: float) -> str:
    """Return the command that sets a current.

    It has five digits, far finer than the supply's resolution. Zero has an exponent so small that
    no single flipped bit makes a current of it.

    Parameters
    ----------
    amperes : float
        Current [A].

    Returns
    -------
    str
        The command.
    """
    return f'CURR {amperes:.4E}' if amperes else 'CURR 0.0E-9'


def text(answer: bytes) -> str | None:
    """Return the line of an answer.

    Parameters
    ----------
    answer : bytes
        Bytes that arrived so far.

    Returns
    -------
    str or None
        None if the end is missing, or if it is not printable ASCII or not a single line.
    """
    content, end, rest = answer.replace(b'\r', b'\n').lstrip(b'\n').partition(b'\n')
    if not end or rest.strip(b'\n') or not all(0x20 <= byte < 0x7F for byte in content):
        return None
    return content.decode('ascii')


def fault(condition: float) -> str:
    """Return the fault that the questionable condition register reports.

    Bits 0 and 1 report a voltage or current away from its setting, as during settling; they are
    ignored.

    Parameters
    ----------
    condition : float
        Value of the register.

    Returns
    -------
    str
        '' for no fault.
    """
    bits = int(condition) & ~0b11
    hot = ', over-temperature' if bits & _OVER_TEMPERATURE else ''
    return f'questionable condition {bits}{hot}' if bits else ''


def number(answer: bytes) -> float | None:
    """Return the number in an answer such as 2.71E1.

    Parameters
    ----------
    answer : bytes
        Bytes that arrived so far.

    Returns
    -------
    float or None
        None if there is no number or its end is missing.
    """
    content = text(answer)
    if content is None or not _NUMBER.fullmatch(content.strip().encode()):
        return None
    return float(content)
