"""What can go wrong on a line or in a device, on command and at a set time."""

from __future__ import annotations

import math
import random
import re
from dataclasses import dataclass

from microbot_ros.common.errors import InputError

KINDS: dict[str, tuple[float, str]] = {
    'drop': (0.01, 'lose each byte with probability VALUE'),
    'flip': (0.01, 'flip one bit of each byte with probability VALUE'),
    'double': (0.01, 'repeat each byte with probability VALUE'),
    'truncate': (0.1, 'truncate each message with probability VALUE'),
    'delay': (100.0, 'answer VALUE ms late'),
    'silence': (0.0, 'read commands and answer none'),
    'reset': (500.0, 'restart the device; it neither reads nor answers for VALUE ms'),
    'wrong_reply': (0.0, 'answer like another model'),
    'over_temperature': (0.0, 'switch the outputs off: overheated'),
    'open': (1.0, 'break the wire of coil VALUE'),
    'reversed': (1.0, 'reverse the current of coil VALUE'),
    'half_gain': (1.0, 'halve the current of coil VALUE'),
    'unplug': (0.0, 'take the line away'),
}
"""Kind of fault → value where none is given, what it does."""

_SHARES = {'open': 0.0, 'reversed': -1.0, 'half_gain': 0.5}
"""Fault of one coil → the share of its current that flows."""
_MOST_COILS = 16
_BYTE_FAULTS = frozenset({'drop', 'flip', 'double'})
_SYNTAX = re.compile(r'([a-z_]+)(?:=([\d.]+))?(?:/(\d+))?(?:@([\d.]+))?(?:\+([\d.]+))?')


@dataclass(frozen=True)
class Fault:
    """A fault of a `kind`, with the `value` that the kind takes, from `start_s` to `end_s` on the
    monotonic clock; of one serial `line`, counted from 1, or of all (0)."""

    kind: str
    value: float
    start_s: float
    end_s: float
    line: int = 0


def parse(text: str, now_s: float) -> Fault:
    """Return the fault that a `text` `KIND[=VALUE][/LINE][@START][+DURATION]` describes.

    Times are in seconds from `now_s`. Without LINE, which counts from 1, it is a fault of all
    lines; without START it begins at once; without DURATION it stays. Raises InputError.
    """
    match = _SYNTAX.fullmatch(text.strip())
    try:
        kind, *numbers = match.groups() if match else ('', None, None, None, None)
        value, line, start, duration = (None if n is None else float(n) for n in numbers)
    except ValueError:
        kind = ''
    if kind not in KINDS:
        known = ', '.join(KINDS)
        raise InputError('--fault', f"expected KIND[=VALUE][/LINE][@START][+DURATION] with one of "
                         f"{known}; received '{text}'")
    value = KINDS[kind][0] if value is None else value
    if not _valid(kind, value):
        raise InputError('--fault', f"{kind}: to {KINDS[kind][1]}; received '{text}'")
    if kind == 'reset':
        duration = value * 1e-3
    begin = now_s + (start or 0.0)
    end = math.inf if duration is None else begin + duration
    return Fault(kind, value, begin, end, int(line or 0))


def _valid(kind: str, value: float) -> bool:
    if kind in _SHARES:
        return value in range(1, _MOST_COILS + 1)
    return 0.0 <= value <= (1.0 if kind in _BYTE_FAULTS | {'truncate'} else 60_000.0)


class Faults:
    """The faults of one emulated amplifier, drawn from one seeded source."""

    def __init__(self, faults: list[Fault]) -> None:
        self._faults = faults
        self._reset_done: set[Fault] = set()
        self._random = random.Random(0)

    def add(self, fault: Fault) -> None:
        """Let one more fault happen."""
        self._faults.append(fault)

    def clear(self) -> None:
        """End all faults."""
        self._faults.clear()

    def due_s(self, now_s: float) -> float:
        """When the next fault begins or ends after `now_s` [s]; inf for never."""
        moments = (moment_s for fault in self._faults for moment_s in (fault.start_s, fault.end_s))
        return min((moment_s for moment_s in moments if moment_s > now_s), default=math.inf)

    def value(self, kind: str, now_s: float, port: int = 0) -> float | None:
        """The value of a `kind` of fault that the line of a `port`, counted from 0, has at
        `now_s`; None where it has none.
        """
        for fault in self._faults:
            if (fault.kind == kind and fault.line in (0, port + 1)
                    and fault.start_s <= now_s < fault.end_s):
                return fault.value
        return None

    def conducted(self, now_s: float, coils: int) -> tuple[tuple[float, ...], str]:
        """The share of its current that each of so many `coils` carries at `now_s`, and the fault
        that says so. A fault of a coil that is not there is none.
        """
        if self.value('over_temperature', now_s) is not None:
            return (0.0,) * coils, 'over_temperature'
        shares, cause = [1.0] * coils, 'repaired'
        for kind, share in _SHARES.items():
            if (coil := self.value(kind, now_s)) is not None and coil <= coils:
                shares[int(coil) - 1], cause = share, kind
        return tuple(shares), cause

    def reset_due(self, now_s: float) -> bool:
        """Whether a reset has come up by `now_s` that was not reported before."""
        due = {fault for fault in self._faults
               if fault.kind == 'reset' and fault.start_s <= now_s} - self._reset_done
        self._reset_done |= due
        return bool(due)

    def damage(self, message: bytes, now_s: float, port: int = 0) -> bytes:
        """What arrives of a `message` that goes on the line of a `port` at `now_s`."""
        if not self._faults:
            return message
        cut = self.value('truncate', now_s, port)
        if cut is not None and message and self._random.random() < cut:
            message = message[:self._random.randrange(len(message))]
        for kind in sorted(_BYTE_FAULTS):
            probability = self.value(kind, now_s, port)
            if probability is not None:
                message = b''.join(self._damaged(kind, byte, probability) for byte in message)
        return message

    def _damaged(self, kind: str, byte: int, probability: float) -> bytes:
        if self._random.random() >= probability:
            return bytes((byte,))
        if kind == 'flip':
            return bytes((byte ^ 1 << self._random.randrange(8),))
        return b'' if kind == 'drop' else bytes((byte, byte))
