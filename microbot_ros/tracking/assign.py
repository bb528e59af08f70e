"""The most likely one-to-one assignment of detections to predictions."""

from __future__ import annotations

import numba
import numpy as np

_MISS_COST = 30.0
"""Cost of leaving a particle unseen: a match may cost at most this."""


def assign(
    predicted: np.ndarray, variance: np.ndarray, reach: np.ndarray, contrast: np.ndarray,
    radius: np.ndarray, found: np.ndarray, noise: np.ndarray, found_contrast: np.ndarray,
    found_radius: np.ndarray, spread: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of predictions and of detections that belong together.

    `predicted` (N, 2) with variance per coordinate (N,) and the farthest distance (N,) to look;
    `found` (M, 2) with variance `noise` (M,); logarithms of contrast and radius of both, which
    vary by `spread` between frames. Minimises the sum of squared normalised differences over the
    picture, where an unmatched prediction costs as much as a match at 5½ standard deviations.
    """
    pairs = _pairs(
        predicted, variance, reach, contrast, radius, found, noise, found_contrast, found_radius,
        spread)
    if len(pairs) == 0:
        return np.empty(0, int), np.empty(0, int)
    track, detection = pairs[:, 0].astype(int), pairs[:, 1].astype(int)
    alone = (np.bincount(track)[track] == 1) & (np.bincount(detection)[detection] == 1)
    matched = [np.column_stack([track[alone], detection[alone]])]
    rest = ~alone
    if np.any(rest):
        matched += _clusters(track[rest], detection[rest], pairs[rest, 2], len(predicted), len(found))
    both = np.concatenate(matched)
    return both[:, 0], both[:, 1]


@numba.njit(cache=True)
def _pairs(predicted, variance, reach, contrast, radius, found, noise, found_contrast, found_radius, spread):  # type: ignore[no-untyped-def]  # noqa: E501
    """Rows (K, 3): prediction, detection, cost of all pairs worth considering."""
    pairs = []
    for i in range(len(predicted)):
        for k in range(len(found)):
            dx, dy = found[k, 0] - predicted[i, 0], found[k, 1] - predicted[i, 1]
            if abs(dx) > reach[i] or abs(dy) > reach[i]:
                continue
            square = dx * dx + dy * dy
            if square > reach[i] * reach[i]:
                continue
            cost = square / (variance[i] + noise[k])
            cost += ((found_contrast[k] - contrast[i]) / spread) ** 2
            cost += ((found_radius[k] - radius[i]) / spread) ** 2
            if cost < _MISS_COST:
                pairs.append((float(i), float(k), cost))
    rows = np.empty((len(pairs), 3))
    for n in range(len(pairs)):
        rows[n, 0], rows[n, 1], rows[n, 2] = pairs[n]
    return rows


def _clusters(
    track: np.ndarray, detection: np.ndarray, cost: np.ndarray, tracks: int, detections: int
) -> list[np.ndarray]:
    """Solve each group of predictions and detections that compete with one another."""
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array(
        (np.ones(len(track)), (track, tracks + detection)),
        shape=(tracks + detections, tracks + detections))
    group = connected_components(graph, directed=False)[1][track]
    matched = []
    order = np.argsort(group, kind='stable')
    for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        some_tracks, i = np.unique(track[rows], return_inverse=True)
        some_found, k = np.unique(detection[rows], return_inverse=True)
        matrix = np.full((len(some_tracks), len(some_found) + len(some_tracks)), 1e6)
        matrix[i, k] = cost[rows]
        matrix[np.arange(len(some_tracks)), len(some_found) + np.arange(len(some_tracks))] = \
            _MISS_COST
        i, k = linear_sum_assignment(matrix)
        real = k < len(some_found)
        matched.append(np.column_stack([some_tracks[i[real]], some_found[k[real]]]))
    return matched
