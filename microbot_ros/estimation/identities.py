"""Identities that a tracker lost: exchanged ones are exchanged back, broken tracks are joined.

Speed and angle of a particle are told by all that is seen of it. Whose tracks are exchanged or
broken is decided only where the positions leave no choice.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from microbot_ros.common.records import Session

JUMP = 6.0
"""Ratio to the 99th percentile above which a step is no motion.

Choice: 18 standard deviations of a Gaussian step; a smaller value splits tracks of uneven motion.
"""

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


def settled_grid(session: Session) -> tuple[
        np.ndarray, np.ndarray, np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return the tracks of a session, whose particles keep their identities if positions decide.

    Parameters
    ----------
    session : Session
        The recording.

    Returns
    -------
    times : ndarray, shape (T,)
        Times of frames [s].
    part : ndarray of int, shape (T,)
        Part of the session between its breaks that each frame belongs to, numbered from 1. Nothing
        is decided across parts.
    z : ndarray of complex, shape (T, N)
        Positions [m]; NaN where a particle is not seen.
    ids : ndarray, shape (N,)
        Identities, ascending; of joined tracks that of the first.
    remarks : tuple of str
        Changes, in words.
    """
    times, positions = session.tracks.grid()
    z, ids = positions[..., 0] + 1j * positions[..., 1], session.tracks.particles
    part = 1 + np.searchsorted(session.breaks, times, side='right')
    seen = np.isfinite(z)
    if not (seen[1:] & seen[:-1]).any():
        return times, part, z, ids, ()
    first = times[0]  # remarks tell times since then
    remarks = [*_exchange_back(times - first, part, z, ids)]
    kept, joined = _join(times, part, z, ids)
    if joined:
        some = ', '.join(f'{late} to {early}' for early, late in joined[:5])
        remarks.append(
            f'{len(joined)} track{" begins" if len(joined) == 1 else "s begin"} where another '
            f'ended at most {LONGEST_GAP:g} s before, with no other near: joined ({some}'
            f'{", …" if len(joined) > 5 else ""}).')
    return times, part, np.ascontiguousarray(z[:, kept]), ids[kept], tuple(remarks)


def _exchange_back(times: np.ndarray, part: np.ndarray, z: np.ndarray, ids: np.ndarray,
                   ) -> Iterator[str]:
    """Exchange, in `z`, tracks that swap places between two frames; yield what was done."""
    steps = np.abs(np.diff(z, axis=0))
    usual = float(np.nanquantile(steps, 0.99))
    both = (np.nan_to_num(steps) > JUMP * usual).sum(axis=1) > 1
    for k in np.flatnonzero(both & (np.diff(part) == 0)):
        end = int(np.searchsorted(part, part[k], side='right'))
        for i in range(z.shape[1]):
            if not abs(z[k + 1, i] - z[k, i]) > JUMP * usual:  # nor where it is not seen
                continue
            crossed = (np.abs(z[k + 1, i] - z[k]) <= usual) & (np.abs(z[k + 1] - z[k, i]) <= usual)
            for j in np.flatnonzero(crossed)[:1]:
                z[k + 1:end, [i, j]] = z[k + 1:end, [j, i]]
                one, other = sorted((ids[i], ids[j]))
                yield (f'particles {one} and {other} exchange places at {times[k + 1]:.2f} s: '
                       'their tracks were swapped, and are exchanged back from there on.')


def _join(times: np.ndarray, part: np.ndarray, z: np.ndarray, ids: np.ndarray,
          ) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Join, in `z`, tracks that continue another.

    Returns
    -------
    kept : ndarray of bool, shape (N,)
        Columns that are left.
    joined : list of (int, int)
        Identities of a particle and of the track that continues it.
    """
    seen, whole = np.isfinite(z), z.copy()
    column = np.arange(z.shape[1])
    first, last = seen.argmax(axis=0), len(times) - 1 - seen[::-1].argmax(axis=0)
    begin, end = z[first, column], z[last, column]
    particle, open_end = column.copy(), seen.any(axis=0)
    kept, joined = np.ones(len(column), bool), []
    ways = _Ways(whole, float(np.median(np.diff(times))))
    begun = [int(n) for n in np.argsort(first, kind='stable') if seen[:, n].any()]
    for late in begun:
        gap = times[first[late]] - times[last]
        before = np.flatnonzero(open_end & (gap > 0) & (gap <= LONGEST_GAP)
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
        if ((np.abs(begin[rivals] - end[early]) <= ALONE * reach).any()
                or (np.abs(whole[last[early], others] - end[early]) <= reach).any()
                or (np.abs(whole[first[late], others] - begin[late]) <= reach).any()):
            continue
        of = particle[late] = particle[early]
        z[seen[:, late], of] = z[seen[:, late], late]
        kept[late] = open_end[early] = False
        joined.append((int(ids[of]), int(ids[late])))
    return kept, joined


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
