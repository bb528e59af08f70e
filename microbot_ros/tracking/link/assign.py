"""Maximum-likelihood one-to-one assignment of detections to predictions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba

_TAIL = 8.0
"""Choice: degrees of freedom of displacements; heavy tails, since particles start and stop."""


@dataclass(frozen=True)
class Pairs:
    """Assigned predictions and detections, arrays of equal length K.

    Attributes
    ----------
    track, detection : (K,) int array
        Rows of the prediction and the detection.
    doubt : (K,) array
        Probability that the prediction is another detection or none, by the likelihood of the next
        best alternatives.
    astray : (K,) array [px²]
        Variance per coordinate of its place in that case, about the assigned detection.
    """

    track: np.ndarray
    detection: np.ndarray
    doubt: np.ndarray
    astray: np.ndarray


def assign(
    predicted: np.ndarray, variance: np.ndarray, reach: np.ndarray, looks: np.ndarray,
    unlikely: np.ndarray, found: np.ndarray, noise: np.ndarray, found_looks: np.ndarray,
    spread: float, stranger: float,
) -> Pairs:
    """Assign detections to predictions by the likelihood of the whole picture.

    Displacements follow Student's t distribution.

    Parameters
    ----------
    predicted : (N, 2) array [px]
        Predicted positions.
    variance, reach : (N,) array [px²], [px]
        Variance per coordinate, and largest distance to search.
    looks : (N, F) array
        Traits of the predicted particles.
    unlikely : (N,) array
        −ln of the probability that each is visible.
    found : (M, 2) array [px]
        Detected positions.
    noise : (M,) array [px²]
        Variance of each detected position, per coordinate.
    found_looks : (M, F) array
        Traits of the detections.
    spread : float
        Standard deviation of the traits from frame to frame.
    stranger : float
        Likelihood [1/px²] that a particle is missed and a new one appears instead.

    Returns
    -------
    Pairs
        The pairs.
    """
    limit = -math.log(stranger)
    track, detection, cost, alone = _pairs(
        predicted, variance, reach, looks, unlikely, found, noise, found_looks, spread, limit)
    # Costs are relative to `limit`, so that assigning neither costs nothing.
    cost -= limit
    lone = Pairs(track[alone], detection[alone], 1 / (1 + np.exp(-cost[alone])),
                 variance[track[alone]])
    if alone.all():
        return lone
    rest = ~alone
    parts = [lone, *_clusters(track[rest], detection[rest], cost[rest], variance, found)]
    return Pairs(*(np.concatenate([getattr(part, name) for part in parts])
                   for name in Pairs.__dataclass_fields__))


@numba.njit(cache=True)
def _pairs(  # type: ignore[no-untyped-def]
        predicted, variance, reach, looks, unlikely, found, noise, found_looks, spread, limit):
    """Return prediction, detection and cost (K,) of all pairs more likely than strangers.

    Also whether neither of the two is in another pair.
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
            cost += math.log(2 * math.pi * total) + unlikely[i]
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


def _clusters(track: np.ndarray, detection: np.ndarray, cost: np.ndarray, variance: np.ndarray,
              found: np.ndarray) -> list[Pairs]:
    """Solve each group of competing predictions and detections."""
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
        i, k = i[real], k[real]
        doubt, astray = _doubts(matrix, i, k, variance[some_tracks], found[some_found])
        matched.append(Pairs(some_tracks[i], some_found[k], doubt, astray))
    return matched


@numba.njit(cache=True)
def _doubts(cost, track, detection, variance, found):  # type: ignore[no-untyped-def]
    """Return `Pairs.doubt` and `Pairs.astray` (K,) within a group, for the chosen pairs.

    Alternatives: the track is at any other detection, whose own track is then at that of the pair
    or missed; or it is missed itself. `cost` (N, M + N) of all pairs.
    """
    owner = np.full(len(found), -1)
    for n in range(len(track)):
        owner[detection[n]] = track[n]
    doubt, astray = np.empty(len(track)), np.empty(len(track))
    for n in range(len(track)):
        i, k = track[n], detection[n]
        weight = math.exp(cost[i, k])
        total, square = weight, weight * variance[i]
        for m in range(len(found)):
            if m == k or cost[i, m] == 0.0:
                continue
            j = owner[m]
            more = cost[i, m] - cost[i, k]
            if j >= 0:
                more += cost[j, k] - cost[j, m]
            away = found[m] - found[k]
            weight = math.exp(-max(more, 0.0))
            total += weight
            square += weight * (away[0] ** 2 + away[1] ** 2) / 2
        doubt[n], astray[n] = total / (1 + total), square / max(total, 1e-300)
    return doubt, astray
