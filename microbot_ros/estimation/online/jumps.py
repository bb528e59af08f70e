"""Particles that jumped, each in one sentence however often it did."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class _Jumps:
    count: int
    least: float
    most: float
    last: float


class JumpNotes:
    """What is to be said of jumps, until a particle has stayed for `seconds` [s]."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._of: dict[int, _Jumps] = {}

    def add(self, t: float, name: int, length: float) -> None:
        """The particle `name` jumped at `t` [s] by a `length` [m]."""
        known = self._of.setdefault(name, _Jumps(0, length, length, t))
        known.count += 1
        known.least, known.most = min(known.least, length), max(known.most, length)
        known.last = t

    def sentences(self, t: float) -> tuple[str, ...]:
        """One for each particle that jumped in the seconds before `t` [s]."""
        self._of = {name: jumps for name, jumps in self._of.items()
                    if t - jumps.last < self._seconds}
        return tuple(
            f'particle {name} {_told(jumps)}: is it still the same one?'
            for name, jumps in sorted(self._of.items()))


def _told(jumps: _Jumps) -> str:
    if jumps.count == 1:
        return f'jumped by {jumps.most * 1e6:.1f} µm'
    return (f'jumped {jumps.count} times, by {jumps.least * 1e6:.0f} to '
            f'{jumps.most * 1e6:.0f} µm')
