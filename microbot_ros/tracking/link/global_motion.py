"""A jump or shaking of the whole picture: someone touches the table, a pump runs."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.refine.neighbours import count_within

_LEAST = 3
"""Choice: particles needed to tell a jump of the picture from their own motion."""

_FEW = 5
"""Choice: particles needed to detect shaking by less than their own steps."""

_VOTERS = 50
"""Choice: particles used for the vote; more add time and no accuracy."""

_SUPPORT = 0.6
"""Choice: share of the particles that must have made the jump."""


def common_displacement(
    expected: np.ndarray, found: np.ndarray, tolerance: float, size: tuple[int, int],
) -> np.ndarray | None:
    """Return the displacement (2,) [px] that maps most `expected` (N, 2) to `found` (M, 2) [px].

    None if half of them are within `tolerance` [px] of a detection already, or if no displacement
    up to a quarter of the picture `size` (height, width) explains most of them. Found by vote:
    each pair of a particle and a detection proposes its offset; the offset with most others within
    the tolerance wins.

    Parameters
    ----------
    expected : ndarray, shape (N, 2)
        Predicted positions [px].
    found : ndarray, shape (M, 2)
        Detections [px].
    tolerance : float
        Distance [px] within which positions are equal.
    size : tuple[int, int]
        Height and width of the picture [px].

    Returns
    -------
    ndarray, shape (2,), or None
        Displacement [px], or None.
    """
    if len(expected) < _LEAST or len(found) < _LEAST:
        return None
    if np.count_nonzero(count_within(expected, found, tolerance)) >= 0.5 * len(expected):
        return None
    from scipy.spatial import cKDTree

    voters = expected[:: -(-len(expected) // _VOTERS)]
    offsets = (found[None] - voters[:, None]).reshape(-1, 2)
    offsets = offsets[np.all(np.abs(offsets) <= np.array(size[::-1]) / 4, axis=1)]
    if len(offsets) < _LEAST:
        return None
    tree = cKDTree(offsets)
    votes = tree.query_ball_point(offsets, tolerance, return_length=True)
    party = tree.query_ball_point(offsets[np.argmax(votes)], tolerance)
    jump = np.median(offsets[party], axis=0)
    landed = expected + jump
    inside = np.all((landed > 0) & (landed < np.array(size[::-1]) - 1), axis=1)
    hit = np.count_nonzero(count_within(landed, found, tolerance))
    enough = hit >= max(_LEAST, _SUPPORT * inside.sum())
    return jump if enough else None


def common_shake(
    expected: np.ndarray, found: np.ndarray, reach: float, tolerance: float,
) -> np.ndarray | None:
    """Return the displacement (2,) [px] of up to `reach` that most of `expected` (N, 2) share.

    `found` (M, 2) [px] are the detections. Offsets within `tolerance` [px] count as equal; the
    vote is that of a jump. None if there are few or they differ.

    Parameters
    ----------
    expected : ndarray, shape (N, 2)
        Predicted positions [px].
    found : ndarray, shape (M, 2)
        Detections [px].
    reach : float
        Largest displacement [px].
    tolerance : float
        Distance [px] within which positions are equal.

    Returns
    -------
    ndarray, shape (2,), or None
        Displacement [px], or None.
    """
    if len(expected) < _FEW or len(found) < _FEW:
        return None
    voters = np.ascontiguousarray(expected[:: -(-len(expected) // _VOTERS)])
    offsets = _offsets(voters, found, reach)
    votes = count_within(offsets, offsets, tolerance)
    if len(votes) == 0 or votes.max() < _SUPPORT * len(voters):
        return None
    middle = offsets[np.argmax(votes)]
    shake: np.ndarray = np.median(
        offsets[np.linalg.norm(offsets - middle, axis=1) <= tolerance], axis=0)
    return shake


@numba.njit(cache=True)
def _offsets(places, found, reach):  # type: ignore[no-untyped-def]
    """Return the offsets (K, 2) from each place to all detections up to `reach` away."""
    offsets = []
    for i in range(len(places)):
        for k in range(len(found)):
            dx, dy = found[k, 0] - places[i, 0], found[k, 1] - places[i, 1]
            if dx * dx + dy * dy <= reach * reach:
                offsets.append((dx, dy))
    rows = np.empty((len(offsets), 2))
    for n in range(len(offsets)):
        rows[n, 0], rows[n, 1] = offsets[n]
    return rows
