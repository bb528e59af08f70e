"""The arithmetic of the allocator, compiled: currents for a field and a pull, and within limits.

Thirty small steps of NumPy take longer than a period of control leaves for them.

The least power within the limits of the coils is a small quadratic programme, solved exactly by
the dual method of Goldfarb and Idnani (Mathematical Programming 27, 1 (1983)): start at the
optimum without limits, add the most violated limit, drop limits that no longer bind, until none
is violated. The heat rises with every step, so the loop ends.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba

# Beyond a limit by less than this part of it is at the limit, to rounding.
_AT = 1e-13
# A limit whose direction lies in those already held, but for this part, can't be held beside them.
_DEPENDENT = 1e-9


@numba.njit(cache=True)
def _most_violated(
    currents: np.ndarray, limits: np.ndarray, skipped: np.ndarray,
) -> tuple[int, float]:
    """The coil that is furthest beyond its limit and not skipped, and its sign; -1: there is none.
    """
    worst, coil = _AT, -1
    for k in range(len(currents)):
        excess = abs(currents[k]) / limits[k] - 1
        if not skipped[k] and excess > worst:
            worst, coil = excess, k
    return coil, math.copysign(1.0, currents[coil])


@numba.njit(cache=True)
def _let_go(prices: np.ndarray, rates: np.ndarray, count: int) -> tuple[int, float]:
    """Which of the held limits is the first to lose its price, and after what step; -1: none."""
    step, first = math.inf, -1
    for j in range(count):
        if rates[j] > 0 and prices[j] / rates[j] < step:
            step, first = prices[j] / rates[j], j
    return first, step


@numba.njit(cache=True)
def _split(vector: np.ndarray, basis: np.ndarray, count: int, parts: np.ndarray) -> None:
    """Write a vector's `parts` along the first rows of an orthonormal basis; leave the rest in it.

    Twice, so that the rest is orthogonal to rounding (Kahan).
    """
    parts[:count] = 0
    for _ in range(2):
        for j in range(count):
            part = 0.0
            for i in range(len(vector)):
                part += basis[j, i] * vector[i]
            parts[j] += part
            for i in range(len(vector)):
                vector[i] -= part * basis[j, i]


@numba.njit(cache=True)
def _decompose(normals: np.ndarray, count: int, basis: np.ndarray, triangle: np.ndarray) -> None:
    """Write basis and triangle with normals[j] = Σᵢ triangle[j, i] basis[i], i ≤ j."""
    for j in range(count):
        basis[j] = normals[j]
        _split(basis[j], basis, j, triangle[j])
        size = math.sqrt(np.dot(basis[j], basis[j]))
        triangle[j, j] = size
        basis[j] /= size


@numba.njit(cache=True)
def _shortest(normals: np.ndarray, bounds: np.ndarray, count: int, basis: np.ndarray,
              triangle: np.ndarray) -> np.ndarray:
    """The shortest mixture at all the held limits, without what the steps' rounding piled up."""
    _decompose(normals, count, basis, triangle)
    mixture, parts = np.zeros(basis.shape[1]), np.zeros(count)
    for j in range(count):
        parts[j] = (bounds[j] - np.dot(triangle[j, :j], parts[:j])) / triangle[j, j]
        mixture += parts[j] * basis[j]
    return mixture


@numba.njit(cache=True)
def within_limits(currents: np.ndarray, spare: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """The cheapest currents (N,) [A] that lie within their limits (N,) [A].

    `currents` (N,) are the cheapest without limits; what may be added are mixtures of the columns
    of `spare` (N, S), orthonormal in the heat. Between them, some currents lie within the limits,
    to rounding: what is left beyond is cut off.
    """
    count, width = spare.shape
    held = np.zeros(count, np.int64)  # coils at their limits, in the order of the next four
    normals, bounds, prices = np.zeros((count, width)), np.zeros(count), np.zeros(count)
    basis, triangle = np.zeros((count, width)), np.zeros((count, count))
    rates, mixture = np.zeros(count), np.zeros(width)
    skipped, number = np.zeros(count, np.bool_), 0
    for _ in range(4 * count):  # each once, seldom twice: rounding does not make it endless
        coil, sign = _most_violated(currents + spare @ mixture, limits, skipped)
        if coil < 0:
            break
        skipped[coil] = True
        inward, bound, price = -sign * spare[coil], sign * currents[coil] - limits[coil], 0.0
        while True:
            away = inward.copy()
            _decompose(normals, number, basis, triangle)
            _split(away, basis, number, rates)
            for j in range(number - 1, -1, -1):
                rates[j] /= triangle[j, j]
                for i in range(j):
                    rates[i] -= triangle[j, i] * rates[j]
            first, step = _let_go(prices, rates, number)
            free = np.dot(away, away) > _DEPENDENT**2 * np.dot(inward, inward)
            full = (bound - np.dot(inward, mixture)) / np.dot(away, away) if free else math.inf
            if full == math.inf and first < 0:
                break
            if full <= step:
                mixture += full * away
                prices[:number] -= full * rates[:number]
                held[number], normals[number], bounds[number] = coil, inward, bound
                prices[number] = price + full
                number += 1
                break
            if free:
                mixture += step * away
            prices[:number] -= step * rates[:number]
            price += step
            number -= 1
            skipped[held[first]] = False
            for j in range(first, number):
                held[j], bounds[j], prices[j] = held[j + 1], bounds[j + 1], prices[j + 1]
                normals[j] = normals[j + 1]
    found = currents + spare @ _shortest(normals, bounds, number, basis, triangle)
    return np.minimum(np.maximum(found, -limits), limits)


@numba.njit(cache=True)
def together(
    field: np.ndarray, pull: np.ndarray, background: np.ndarray, unlimited: np.ndarray,
    spare: np.ndarray, along: np.ndarray, least: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The cheapest currents (N,) [A] for a field (axes,) [T] and a pull (axes,) [T/m], unlimited.

    Currents are `unlimited` (N, axes) @ (field − background), the cheapest for the field, and a
    mixture of the columns of `spare` (N, S), orthonormal in the heat, which make no field. With
    `along` (axes, axes N), b @ along are the rows of the pull per ampere. Directions of the pull
    whose singular value over the spare currents is below `least` are not made.

    Returns the currents, the rows (axes, N), what is still spare (N, ·), the directions (·, axes)
    that are not made, and how much of the pull [T/m] lies along each of them.
    """
    axes, count = len(field), len(unlimited)
    rows = (field / math.sqrt(np.sum(field * field)) @ along).reshape(axes, count)
    left, size, right = np.linalg.svd(rows @ spare, full_matrices=True)
    rank = int(np.sum(size > least))
    # Transposed views aside, so that every product is of whole arrays.
    directions, mixtures = np.ascontiguousarray(left.T), np.ascontiguousarray(right.T)
    currents = unlimited @ (field - background)
    gap = directions @ (pull - rows @ currents)
    step = np.zeros(len(mixtures))
    step[:rank] = gap[:rank] / size[:rank]
    freed = spare @ mixtures
    return (currents + freed @ step, rows, np.ascontiguousarray(freed[:, rank:]),
            directions[rank:], np.abs(gap[rank:]))
