"""Faults of a line or a device, on command and at a set time."""

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
"""Default value and description of each kind of fault. Choice: defaults that a driver meets within
seconds."""

_SHARES = {'open': 0.0, 'reversed': -1.0, 'half_gain': 0.5}
"""Share of its current that flows, by fault of one coil; the values define the faults."""
_MOST_COILS = 16
"""Largest number of a coil, the most that any amplifier drives (`Amplifier.most_channels`)."""
_BYTE_FAULTS = frozenset({'drop', 'flip', 'double'})
_SYNTAX = re.compile(r'([a-z_]+)(?:=([\d.]+))?(?:/(\d+))?(?:@([\d.]+))?(?:\+([\d.]+))?')


@dataclass(frozen=True)
class Fault:
    """A fault of a line or of a device.

    Attributes
    ----------
    kind : str
        Its kind, a key of `KINDS`.
    value : float
        Value of the kind.
    start_s : float
        Start [s] on the monotonic clock.
    end_s : float
        End [s] on the monotonic clock.
    line : int
        Number of the serial line, from 1; 0 for all.
    """

    kind: str
    value: float
    start_s: float
    end_s: float
    line: int = 0

    def check(self, channels: int, lines: int) -> None:
        """Raise InputError for a fault of a coil or of a line that the device does not have.

        Parameters
        ----------
        channels : int
            Number of coils.
        lines : int
            Number of serial lines.
        """
        if self.kind in _SHARES and self.value > channels:
            raise InputError('--fault', f'{self.kind}: expected a coil from 1 to {channels}; '
                                        f'received {self.value:g}')
        if self.line > lines:
            raise InputError('--fault', f'{self.kind}: expected a line from 1 to {lines}; '
                                        f'received {self.line}')


def parse(text: str, now_s: float) -> Fault:
    """Return the fault that a text `KIND[=VALUE][/LINE][@START][+DURATION]` describes.

    Times are in seconds from `now_s`. Without LINE, which counts from 1, it is a fault of all
    lines; without START it begins at once; without DURATION it stays.

    Parameters
    ----------
    text : str
        Description of the fault.
    now_s : float
        Present time [s] of the monotonic clock.

    Returns
    -------
    Fault
        The fault.

    Raises
    ------
    InputError
        If the text is not of this form or a value is out of range.
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
    """The faults of one emulated amplifier, drawn from one seeded source.

    Parameters
    ----------
    faults : list of Fault
        Planned faults.
    """

    def __init__(self, faults: list[Fault]) -> None:
        self._faults = faults
        self._reset_done: set[Fault] = set()
        self._random = random.Random(0)

    def add(self, fault: Fault) -> None:
        """Add one fault.

        Parameters
        ----------
        fault : Fault
            The fault.
        """
        self._faults.append(fault)

    def clear(self) -> None:
        """End all faults."""
        self._faults.clear()

    def due_s(self, now_s: float) -> float:
        """Return the time at which the next fault begins or ends.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        float
            Time [s] after `now_s`; inf for never.
        """
        moments = (moment_s for fault in self._faults for moment_s in (fault.start_s, fault.end_s))
        return min((moment_s for moment_s in moments if moment_s > now_s), default=math.inf)

    def value(self, kind: str, now_s: float, port: int = 0) -> float | None:
        """Return the value of a fault that a line has now.

        Parameters
        ----------
        kind : str
            Kind of the fault.
        now_s : float
            Present time [s] of the monotonic clock.
        port : int
            Index of the line, from 0.

        Returns
        -------
        float or None
            None if the line has no such fault.
        """
        for fault in self._faults:
            if (fault.kind == kind and fault.line in (0, port + 1)
                    and fault.start_s <= now_s < fault.end_s):
                return fault.value
        return None

    def conducted(self, now_s: float, coils: int) -> tuple[tuple[float, ...], str]:
        """Return the share of its current that each coil carries now, and the cause.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.
        coils : int
            Number of coils. Faults of higher coils are ignored.

        Returns
        -------
        tuple[tuple of float, str]
            Shares (N,) and the kind of the fault that causes them.
        """
        if self.value('over_temperature', now_s) is not None:
            return (0.0,) * coils, 'over_temperature'
        shares, cause = [1.0] * coils, 'repaired'
        for kind, share in _SHARES.items():
            if (coil := self.value(kind, now_s)) is not None and coil <= coils:
                shares[int(coil) - 1], cause = share, kind
        return tuple(shares), cause

    def reset_due(self, now_s: float) -> bool:
        """Return whether a reset is due that was not reported before.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        bool
            Whether one is due.
        """
        due = {fault for fault in self._faults
               if fault.kind == 'reset' and fault.start_s <= now_s} - self._reset_done
        self._reset_done |= due
        return bool(due)

    def damage(self, message: bytes, now_s: float, port: int = 0) -> bytes:
        """Return the bytes that arrive of a message.

        Parameters
        ----------
        message : bytes
            Bytes that are sent.
        now_s : float
            Present time [s] of the monotonic clock.
        port : int
            Index of the line, from 0.

        Returns
        -------
        bytes
            Bytes that arrive.
        """
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
