"""The most likely one-to-one assignment of detections to predictions."""

from __future__ import annotations

import math

import numba
import numpy as np

_TAIL = 8.0
"""Degrees of freedom of a displacement's distribution: particles start, stop and turn at once."""


def assign(
    predicted: np.ndarray, variance: np.ndarray, reach: np.ndarray, looks: np.ndarray,
    found: np.ndarray, noise: np.ndarray, found_looks: np.ndarray, spread: float, stranger: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of predictions and of detections that belong together.

    `predicted` (N, 2) [px] with variance per coordinate (N,) and the farthest distance to look,
    `reach` (N,) [px]; `found` (M, 2) with variance `noise` (M,); `looks` (N, F) and `found_looks`
    (M, F) are traits that vary by `spread` from frame to frame. Maximises the likelihood of the
    whole picture: displacements follow Student's t, and `stranger` [1/px²] is the likelihood that
    a particle goes unseen and a new one turns up instead.
    """
    limit = -math.log(stranger)
    track, detection, cost, alone = _pairs(
        predicted, variance, reach, looks, found, noise, found_looks, spread, limit)
    if alone.all():
        return track, detection
    rest = ~alone
    # Costs are relative to `limit`, so that leaving both alone costs nothing.
    both = np.concatenate([
        np.column_stack([track[alone], detection[alone]]),
        *_clusters(track[rest], detection[rest], cost[rest] - limit)])
    return both[:, 0].copy(), both[:, 1].copy()


@numba.njit(cache=True)
def _pairs(predicted, variance, reach, looks, found, noise, found_looks, spread, limit):  # type: ignore[no-untyped-def]
    """Prediction, detection and cost (K,) of all pairs likelier than strangers.

    And whether neither of the two is in another pair.
    """
    pairs = []
    rivals, found_rivals = np.zeros(len(predicted), np.int64), np.zeros(len(found), np.int64)
    for i in range(len(predicted)):
        for k in range(len(found)):
            dx, dy = found[k, 0] - predicted[i, 0], found[k, 1] - predicted[i, 1]
            if abs(dx) > reach[i] or abs(dy) > reach[i]:
                continue
            square = dx * dx + dy * dy
            if square > reach[i] * reach[i]:
                continue
            total = variance[i] + noise[k]
            cost = (_TAIL / 2 + 1) * math.log(1 + square / (_TAIL * total))
            cost += math.log(2 * math.pi * total)
            for f in range(looks.shape[1]):
                cost += 0.5 * ((found_looks[k, f] - looks[i, f]) / spread) ** 2
            if cost < limit:
                pairs.append((i, k, cost))
                rivals[i] += 1
                found_rivals[k] += 1
    track, detection = np.empty(len(pairs), np.int64), np.empty(len(pairs), np.int64)
    costs, alone = np.empty(len(pairs)), np.empty(len(pairs), np.bool_)
    for n in range(len(pairs)):
        track[n], detection[n], costs[n] = pairs[n]
        alone[n] = rivals[track[n]] == 1 and found_rivals[detection[n]] == 1
    return track, detection, costs, alone


def _clusters(track: np.ndarray, detection: np.ndarray, cost: np.ndarray) -> list[np.ndarray]:
    """Solve each group of predictions and detections that compete with one another."""
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    tracks, total = track.max() + 1, track.max() + 1 + detection.max() + 1
    graph = coo_array((np.ones(len(track)), (track, tracks + detection)), shape=(total, total))
    group = connected_components(graph, directed=False)[1][track]
    matched = []
    order = np.argsort(group, kind='stable')
    for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        some_tracks, i = np.unique(track[rows], return_inverse=True)
        some_found, k = np.unique(detection[rows], return_inverse=True)
        matrix = np.zeros((len(some_tracks), len(some_found) + len(some_tracks)))
        matrix[i, k] = cost[rows]
        i, k = linear_sum_assignment(matrix)
        real = matrix[i, k] < 0
        matched.append(np.column_stack([some_tracks[i[real]], some_found[k[real]]]))
    return matched
