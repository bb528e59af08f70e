"""Which particle, or which clock, is the culprit when numbers cannot be trusted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from microbot_ros.estimation.online.estimates import State

COMPARED = 5.0
"""A change of speed or direction is told by comparison with this many seconds ago."""

SURE = 40.0
"""Squared distance, χ² of two axes, beyond which c is not what it was: 2e-9 by chance."""

IMMOBILE = 0.3e-6
"""A particle that swims slower than can be told from this [m/s] does not follow the field."""

AHEAD, ANOTHER_CLOCK = 5.0, 86400.0
"""Seconds by which a command may be ahead of the frames, and by which it may be behind."""


@dataclass
class TrackFaults:
    """Finds, asked about once a second, which track or clock cannot be right."""

    _past: list[State] = field(default_factory=list)
    _close: set[tuple[int, int]] = field(default_factory=set)

    def forget(self) -> None:
        """Forget the past, as when something shared has been corrected."""
        self._past.clear()

    def find(self, now: State, last_command: float, moving: bool) -> list[str]:
        """Sentences on what is wrong with the filter's state `now`.

        `last_command` [s]: the time of the newest one, −inf for none; `moving`: whether the
        command drives particles.
        """
        told = _clock(now.t, last_command)
        told += self._changes(now)
        told += self._duplicates(now)
        if moving:
            told += [
                f'particle {name} does not follow the field: stuck, or not a swimmer?'
                for name, c, std in zip(
                    now.ids, now.velocity_phasor, np.sqrt(now.phasor_var), strict=True)
                if std < IMMOBILE and abs(c) < max(3 * std, IMMOBILE / 3)
            ]
        return told

    def _changes(self, now: State) -> list[str]:
        self._past = [past for past in self._past if now.t - past.t <= COMPARED + 0.5] + [now]
        then = self._past[0]
        common, here, there = np.intersect1d(now.ids, then.ids, return_indices=True)
        spread = now.phasor_var[here] + then.phasor_var[there]
        after, before = now.velocity_phasor[here], then.velocity_phasor[there]
        moved = np.abs(after - before) ** 2 / spread > SURE
        return [
            f'speed or angle of particle {name} changed within {now.t - then.t:.0f} s: '
            f'{abs(old) * 1e6:.2f} → {abs(new) * 1e6:.2f} µm/s, turned by '
            f'{np.degrees(np.angle(new * np.conj(old))):+.0f}°'
            for name, old, new in zip(common[moved], before[moved], after[moved], strict=True)
        ]

    def _duplicates(self, now: State) -> list[str]:
        """Pairs nearer to each other than they are known, now and when last asked."""
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
