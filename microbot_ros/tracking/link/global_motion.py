"""A jump of the whole picture, or its shaking: somebody touched the table, or a pump runs."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.refine.neighbours import count_within

_LEAST = 3
"""Particles: fewer can't tell a jump of the picture from motion of their own."""

_FEW = 5
"""Particles: fewer can't tell that it shakes, for less than what they step themselves."""

_VOTERS = 50
"""Particles that are asked; the others are as good."""

_SUPPORT = 0.6
"""Share of the particles that must have made the jump."""


def common_displacement(
    expected: np.ndarray, found: np.ndarray, tolerance: float, size: tuple[int, int],
) -> np.ndarray | None:
    """The displacement (2,) [px] that brings most of `expected` (N, 2) onto `found` (M, 2).

    None where half of them are within `tolerance` [px] of a detection as it is, or where no
    displacement up to a quarter of the picture `size` (height, width) explains most of them.
    Found by vote: each pair of a particle and a detection proposes its offset, and the offset
    with most others within the tolerance wins.
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
    """The displacement (2,) [px] of up to `reach` that most of `expected` (N, 2) have made alike.

    `found` (M, 2) [px] are the detections. Alike is within `tolerance` [px]; by the same vote as a
    jump. None where few tell, or differ.
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
    """From each of the places to all that was found up to `reach` away: (K, 2)."""
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
