"""Roboteq's text protocol: lines that end at CR; commands are answered with + or −."""

from __future__ import annotations

import re

FULL_COMMAND = 1000
CURRENT_STEP_A = 0.1
END = b'\r'

_FAULTS = ('overheat', 'overvoltage', 'undervoltage', 'short circuit', 'emergency stop',
           'sensor or setup fault', 'MOSFET failure')
"""Bits of the fault flags, the lowest first (user manual, query FF); bit 7 tells that the default
configuration was loaded, and those above it differ between models."""
_FLAGS = re.compile(rb'\d{1,5}')
_VALUES = re.compile(rb'(-?\d{1,5}):(-?\d{1,5})')


def drive(first: float, second: float) -> bytes:
    """Commands −1 … 1 for channels 1 (`first`) and 2 (`second`); ValueError outside."""
    if not all(-1.0 <= share <= 1.0 for share in (first, second)):
        raise ValueError(f'commands must be −1 … 1; received {first}, {second}')
    return b''.join(line(f'!G {channel} {round(share * FULL_COMMAND)}')
                    for channel, share in ((1, first), (2, second)))


def line(text: str) -> bytes:
    """One command or query, `text`."""
    return text.encode('ascii') + END


def accepted(count: int, received: bytes) -> bool | None:
    """True where `count` commands were accepted in `received`; None where incomplete or refused.
    """
    return True if received == (b'+' + END) * count else None


def text(name: str, received: bytes) -> str | None:
    """What follows `name=` in `received`; None where that is incomplete or another's answer."""
    prefix = name.encode('ascii') + b'='
    content, end, rest = received.partition(END)
    if not end or rest or not content.startswith(prefix):
        return None
    return content.removeprefix(prefix).decode('ascii', 'replace')


def faults(received: bytes) -> tuple[str, ...] | None:
    """What `received`, an answer to `?FF`, says is wrong; None where incomplete or damaged."""
    content = text('FF', received)
    if content is None or not _FLAGS.fullmatch(content.encode()):
        return None
    return tuple(name for bit, name in enumerate(_FAULTS) if int(content) >> bit & 1)


def currents(received: bytes) -> tuple[float, float] | None:
    """The currents [A] of both channels in `received`; None where incomplete or damaged."""
    content = text('A', received)
    match = _VALUES.fullmatch(content.encode()) if content is not None else None
    if match is None:
        return None
    return int(match[1]) * CURRENT_STEP_A, int(match[2]) * CURRENT_STEP_A
