"""The lines of SCPI that a bipolar supply needs, and the numbers it sends back."""

from __future__ import annotations

import re

CLEAR_INPUT = b'\x1b'
"""ESC empties the supply's input buffer."""
LONGEST_LINE = 253
"""More characters than this in a line overflow the supply's buffer."""

_OVER_TEMPERATURE = 0b11000
"""Bit 3 in Kepco's BIT 232 interface, bit 4 in SCPI-1999."""
_NUMBER = re.compile(rb'[+-]?\d{1,30}(\.\d*)?(E[+-]?\d{1,2})?')


def line(*commands: str) -> bytes:
    """Commands as one line; ValueError where the supply could not take it."""
    text = ';'.join(commands).encode('ascii') + b'\n'
    if len(text) > LONGEST_LINE:
        raise ValueError(f'a line must be at most {LONGEST_LINE} bytes; received {len(text)}')
    return text


def current(amperes: float) -> str:
    """Return the command that sets a current of `amperes`: five digits, far finer than the
    supply's.

    Zero has an exponent so small that no bit which flips on the line makes a current of it.
    """
    return f'CURR {amperes:.4E}' if amperes else 'CURR 0.0E-9'


def text(answer: bytes) -> str | None:
    """The answer's line; None where its end has not come, where it is not printable ASCII or not
    alone.
    """
    content, end, rest = answer.replace(b'\r', b'\n').lstrip(b'\n').partition(b'\n')
    if not end or rest.strip(b'\n') or not all(0x20 <= byte < 0x7F for byte in content):
        return None
    return content.decode('ascii')


def fault(condition: float) -> str:
    """What the questionable condition register says is wrong; '' where nothing is.

    Bits 0 and 1 say that voltage or current is not where it was set, as while it settles.
    """
    bits = int(condition) & ~0b11
    hot = ', over-temperature' if bits & _OVER_TEMPERATURE else ''
    return f'questionable condition {bits}{hot}' if bits else ''


def number(answer: bytes) -> float | None:
    """The number in an answer such as 2.71E1; None where there is none or its end is missing."""
    content = text(answer)
    if content is None or not _NUMBER.fullmatch(content.strip().encode()):
        return None
    return float(content)
