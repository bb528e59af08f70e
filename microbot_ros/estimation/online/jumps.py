"""Notes on particles that jumped, one sentence each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class _Jumps:
    count: int
    least: float
    most: float
    last: float


class JumpNotes:
    """Notes on jumps, kept until a particle has not jumped for some time.

    Parameters
    ----------
    seconds : float
        That time [s].
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._of: dict[int, _Jumps] = {}

    def add(self, t: float, name: int, length: float) -> None:
        """Add a jump.

        Parameters
        ----------
        t : float
            Time [s].
        name : int
            The particle.
        length : float
            Length of the jump [m].
        """
        known = self._of.setdefault(name, _Jumps(0, length, length, t))
        known.count += 1
        known.least, known.most = min(known.least, length), max(known.most, length)
        known.last = t

    def sentences(self, t: float) -> tuple[str, ...]:
        """Return a sentence for each particle that jumped recently.

        Parameters
        ----------
        t : float
            Time now [s].

        Returns
        -------
        tuple of str
            Sorted by particle.
        """
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
