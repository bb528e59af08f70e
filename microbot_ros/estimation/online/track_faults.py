"""Tracks and clocks that cannot be right, named when numbers are doubtful."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from microbot_ros.estimation.online.estimates import State

COMPARED = 5.0
"""Time [s] over which speed and direction are compared.

Choice: long enough for small errors of both, short enough for a timely sentence.
"""

SURE = 40.0
"""Squared distance, χ² of two axes, above which c has changed: 2e-9 by chance."""

IMMOBILE = {'catalytic': 0.3e-6, 'rolling': 0.05e-6}
"""Speed [m/s], and of rollers per frequency [m/s/Hz], below which a particle does not follow.

Choice: a tenth of usual ones; a smaller value needs longer to be known. A sphere of 1 µm radius
would roll 6.3 µm in a turn, and slips by 90 %.
"""

AHEAD, ANOTHER_CLOCK = 5.0, 86400.0
"""Time [s] by which a command may be later than the frames, and earlier (`ANOTHER_CLOCK`).

Choice: clocks of one rig agree to seconds; a command may be in force for a day.
"""


@dataclass
class TrackFaults:
    """Search, once a second, for tracks and clocks that cannot be right.

    Parameters
    ----------
    propulsion : str
        'catalytic' or 'rolling'.
    """

    propulsion: str = 'catalytic'
    _past: list[State] = field(default_factory=list)
    _close: set[tuple[int, int]] = field(default_factory=set)

    def forget(self) -> None:
        """Forget the past, as after a correction of something shared."""
        self._past.clear()

    def find(self, now: State, last_command: float, moving: bool) -> list[str]:
        """Return sentences on tracks and clocks that cannot be right.

        Parameters
        ----------
        now : State
            State of the filter.
        last_command : float
            Time of the newest command [s]; −inf for none.
        moving : bool
            Whether the command drives particles.

        Returns
        -------
        list of str
            Sentences.
        """
        slow, rolls = IMMOBILE[self.propulsion], self.propulsion == 'rolling'
        told = _clock(now.t, last_command)
        told += self._changes(now)
        told += self._duplicates(now)
        if moving:
            told += [
                f'particle {name} does not follow the field: stuck, or not a '
                f'{"roller" if rolls else "swimmer"}?'
                for name, c, std in zip(
                    now.ids, now.velocity_phasor, np.sqrt(now.phasor_var), strict=True)
                if std < slow and abs(c) < max(3 * std, slow / 3)
            ]
        return told

    def _changes(self, now: State) -> list[str]:
        self._past = [past for past in self._past if now.t - past.t <= COMPARED + 0.5] + [now]
        then = self._past[0]
        common, here, there = np.intersect1d(now.ids, then.ids, return_indices=True)
        spread = now.phasor_var[here] + then.phasor_var[there]
        after, before = now.velocity_phasor[here], then.velocity_phasor[there]
        moved = np.abs(after - before) ** 2 / spread > SURE
        unit = 'µm/s/Hz' if self.propulsion == 'rolling' else 'µm/s'
        return [
            f'speed or angle of particle {name} changed within {now.t - then.t:.0f} s: '
            f'{abs(old) * 1e6:.2f} → {abs(new) * 1e6:.2f} {unit}, turned by '
            f'{np.degrees(np.angle(new * np.conj(old))):+.0f}°'
            for name, old, new in zip(common[moved], before[moved], after[moved], strict=True)
        ]

    def _duplicates(self, now: State) -> list[str]:
        """Return sentences on pairs that are closer than their errors, now and last time."""
        from scipy.spatial import cKDTree

        seen = now.seen & np.isfinite(now.p)
        places = np.stack([now.p[seen].real, now.p[seen].imag], axis=-1)
        ids, std = now.ids[seen], np.sqrt(now.p_var[seen])
        reach = 6 * float(std.max(initial=0))
        pairs = cKDTree(places).query_pairs(reach) if len(places) > 1 else set()
        near = {
            (int(ids[i]), int(ids[j])) for i, j in pairs
            if np.hypot(*(places[i] - places[j])) < 4 * np.hypot(std[i], std[j])
        }
        both, self._close = near & self._close, near
        return [
            f'particles {a} and {b} have the same position: two tracks of one particle?'
            for a, b in sorted(both)
        ]


def _clock(t: float, last_command: float) -> list[str]:
    if not np.isfinite(last_command):
        return ['no command received: speed and φ cannot be estimated']
    ahead = last_command - t
    if ahead > AHEAD or ahead < -ANOTHER_CLOCK:
        side = 'after' if ahead > 0 else 'before'
        return [f'commands are stamped {abs(ahead):.3g} s {side} the frames: different clocks?']
    return []
