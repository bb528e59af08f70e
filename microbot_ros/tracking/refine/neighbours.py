"""Neighbours among fitted particles (rows as in `fit`), and between two sets of positions."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.refine.fit import CONTRAST, X, Y


@numba.njit(cache=True)
def _downwards(rows):  # type: ignore[no-untyped-def]
    """Return the order of particles by y, by insertion: the search nearly sorts them so."""
    order = np.arange(len(rows))
    for m in range(1, len(order)):
        i, k = order[m], m
        while k > 0 and rows[order[k - 1], Y] > rows[i, Y]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
    return order


@numba.njit(cache=True)
def _pairs(rows, near):  # type: ignore[no-untyped-def]
    """Return particles within `near` px of each other, the upper one first."""
    pairs = []
    order = _downwards(rows)
    for m in range(len(order)):
        i = order[m]
        for n in range(m + 1, len(order)):
            j = order[n]
            dx, dy = rows[j, X] - rows[i, X], rows[j, Y] - rows[i, Y]
            if not dy < near:
                break
            if dx * dx + dy * dy < near * near:
                pairs.append((i, j))
    return pairs


@numba.njit(cache=True)
def neighbours(parameters, near):  # type: ignore[no-untyped-def]
    """Return the particles within `near` px of each: those of n are other[first[n]:first[n + 1]].

    `parameters` (N, 6) as in `fit.fit`.

    Parameters
    ----------
    parameters : ndarray, shape (N, 6)
        Parameters of the particles, as in `fit.fit`.
    near
        Distance [px].
    """
    pairs = _pairs(parameters, near)
    first = np.zeros(len(parameters) + 1, np.int64)
    for i, j in pairs:
        first[i + 1] += 1
        first[j + 1] += 1
    first = np.cumsum(first)
    other, free = np.empty(2 * len(pairs), np.int64), first.copy()
    for i, j in pairs:
        other[free[i]], other[free[j]] = j, i
        free[i] += 1
        free[j] += 1
    return first, other


@numba.njit(cache=True)
def doubled(rows, good, closest):  # type: ignore[no-untyped-def]
    """Return whether a good particle of higher contrast lies closer than `closest` px, (N,).

    `rows` (N, 6) as in `fit.fit`; `good` (N,).

    Parameters
    ----------
    rows : ndarray, shape (N, 6)
        Parameters of the particles, as in `fit.fit`.
    good : ndarray, shape (N,)
        Whether each is good.
    closest
        Distance [px].
    """
    doubled = np.zeros(len(rows), np.bool_)
    for i, j in _pairs(rows, closest):
        if good[i] and good[j]:
            doubled[i if rows[i, CONTRAST] < rows[j, CONTRAST] else j] = True
    return doubled


@numba.njit(cache=True)
def count_within(places, others, distance):  # type: ignore[no-untyped-def]
    """Return how many of `others` (M, 2) lie within `distance` of each of `places` (N, 2).

    Parameters
    ----------
    places : ndarray, shape (N, 2)
        Places [px].
    others : ndarray, shape (M, 2)
        Other places [px].
    distance
        Distance [px].
    """
    count = np.zeros(len(places), np.int64)
    for i in range(len(places)):
        for k in range(len(others)):
            dx, dy = others[k, 0] - places[i, 0], others[k, 1] - places[i, 1]
            count[i] += dx * dx + dy * dy <= distance * distance
    return count
