"""A jump of the whole picture: somebody touched the table."""

from __future__ import annotations

import numpy as np

from microbot_ros.tracking.neighbours import count_within

_LEAST = 3
"""Particles: fewer can't tell a jump of the picture from motion of their own."""

_VOTERS = 50
"""Particles that are asked; the others are as good."""

_SUPPORT = 0.6
"""Share of the particles that must have made the jump."""


def common_jump(
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
