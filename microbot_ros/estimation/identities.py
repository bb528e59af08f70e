"""Identities that a tracker lost: exchanged ones are exchanged back, broken tracks are joined.

Speed and angle of a particle are told by all that is seen of it. Whose tracks are exchanged or
broken is decided only where the positions leave no choice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.estimation.likelihood.prepared_session import JUMP
from microbot_ros.model.physics.vectors import as_complex

LONGEST_GAP = 1.0
"""Longest time [s] between the end of a track and the beginning of one that continues it.

Choice: some tens of frames; after longer gaps particles may be anywhere.
"""

FARTHEST, ALONE = 1.5, 3.0
"""Largest distance of a track from the end of the one that it continues, in 99th percentiles of
the way that particles go in the time between. Within ALONE times that distance no other track may
end or begin meanwhile.

Choice: one gap in a hundred is longer than the percentile; with a larger ALONE tracks of a dense
suspension stay broken, with a smaller one strangers are joined.
"""


def settle_identities(session: Session) -> tuple[Session, tuple[str, ...]]:
    """Return a session whose particles keep their identities, as far as positions decide.

    Nothing is decided across the breaks of the session.

    Parameters
    ----------
    session : Session
        The recording.

    Returns
    -------
    session : Session
        The same positions. A joined track has the identity of the one that it continues.
    changes : tuple of str
        What was changed, in words, with times since the first frame.
    """
    tracks = session.tracks
    times, positions = tracks.grid()
    z, ids = as_complex(positions), tracks.particles
    seen = np.isfinite(z)
    if not (seen[1:] & seen[:-1]).any():
        return session, ()
    part = np.searchsorted(session.breaks, times, side='right')
    shown = np.broadcast_to(np.arange(len(ids)), z.shape).copy()
    changes = [*_exchange_back(times - times[0], part, z, shown, ids)]
    continued = _continued(times, part, z)
    joined = np.flatnonzero(continued != np.arange(len(ids)))
    if len(joined):
        some = ', '.join(f'{ids[late]} to {ids[continued[late]]}' for late in joined[:5])
        changes.append(
            f'{len(joined)} track{" begins" if len(joined) == 1 else "s begin"} where another '
            f'ended at most {LONGEST_GAP:g} s before, with no other near: joined ({some}'
            f'{", …" if len(joined) > 5 else ""}).')
    if not changes:
        return session, ()
    row, column = times.searchsorted(tracks.t), ids.searchsorted(tracks.particle)
    particle = ids[continued[np.argsort(shown, axis=1)[row, column]]]
    return replace(session, tracks=replace(tracks, particle=particle)), tuple(changes)


def _exchange_back(times: np.ndarray, part: np.ndarray, z: np.ndarray, shown: np.ndarray,
                   ids: np.ndarray) -> Iterator[str]:
    """Exchange tracks that swap places between two frames; yield what was done.

    Their columns are exchanged in the positions `z` (T, N) and in `shown` (T, N) alike.
    """
    steps = np.abs(np.diff(z, axis=0))
    usual = float(np.nanquantile(steps, 0.99))
    several = (np.nan_to_num(steps) > JUMP * usual).sum(axis=1) > 1
    for k in np.flatnonzero(several & (np.diff(part) == 0)):
        later = slice(k + 1, int(np.searchsorted(part, part[k], side='right')))
        for i in range(z.shape[1]):
            if not abs(z[k + 1, i] - z[k, i]) > JUMP * usual:  # nor where it is not seen
                continue
            crossed = (np.abs(z[k + 1, i] - z[k]) <= usual) & (np.abs(z[k + 1] - z[k, i]) <= usual)
            for j in np.flatnonzero(crossed)[:1]:
                for one in (z, shown):
                    one[later, [i, j]] = one[later, [j, i]]
                first, second = sorted((ids[i], ids[j]))
                yield (f'particles {first} and {second} exchange places at {times[k + 1]:.2f} s: '
                       'their tracks were swapped, and are exchanged back from there on.')


def _continued(times: np.ndarray, part: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return which track each of the tracks `z` (T, N) continues, itself if none: (N,)."""
    seen, column = np.isfinite(z), np.arange(z.shape[1])
    first, last = seen.argmax(axis=0), len(times) - 1 - seen[::-1].argmax(axis=0)
    begin, end = z[first, column], z[last, column]
    ways = _Ways(z, float(np.median(np.diff(times))))
    continued, is_open = column.copy(), seen.any(axis=0)
    for late in np.argsort(first, kind='stable'):
        gap = times[first[late]] - times[last]
        before = np.flatnonzero(is_open & (gap > 0) & (gap <= LONGEST_GAP)
                                & (part[last] == part[first[late]]))
        near = FARTHEST * np.array([ways.within(gap[one]) for one in before])
        apart = np.abs(end[before] - begin[late])
        close = np.flatnonzero(apart <= ALONE * near)
        if len(close) != 1 or apart[close[0]] > near[close[0]]:
            continue
        early, reach = before[close[0]], near[close[0]]
        others = column[(column != late) & (column != early)]
        since = times[first[others]] - times[last[early]]
        rivals = others[(since > 0) & (since <= LONGEST_GAP)]
        alone = ((np.abs(begin[rivals] - end[early]) > ALONE * reach).all()
                 and not (np.abs(z[last[early], others] - end[early]) <= reach).any()
                 and not (np.abs(z[first[late], others] - begin[late]) <= reach).any())
        if alone:
            continued[late], is_open[early] = continued[early], False
    return continued


class _Ways:
    """How far particles go, by the tracks `z` (T, N) of frames every `interval` [s]."""

    def __init__(self, z: np.ndarray, interval: float) -> None:
        self._z, self._interval = z, interval
        self._known: dict[int, float] = {}

    def within(self, seconds: float) -> float:
        """Return the 99th percentile of the distances [m] in a time, 0 if unknown."""
        ahead = max(round(seconds / self._interval), 1)
        if ahead not in self._known:
            gone = np.abs(self._z[ahead:] - self._z[:-ahead])
            gone = gone[np.isfinite(gone)]
            self._known[ahead] = float(np.quantile(gone, 0.99)) if gone.size else 0.0
        return self._known[ahead]
