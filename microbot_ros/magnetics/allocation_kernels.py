"""Compiled arithmetic of the allocator: currents for a field, within the limits.

It is compiled because thirty small NumPy calls take longer than a control period allows.

The least power within the limits of the coils is a small quadratic programme, solved exactly by
the dual method of Goldfarb and Idnani (Mathematical Programming 27, 1 (1983)): start at the
unlimited optimum, add the most violated limit, drop limits that no longer bind, until none is
violated. The heat rises with every step, so the loop ends.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba

# Choice: relative excess over a limit that counts as rounding, some 500 units of a double.
_AT = 1e-13
# Choice: a limit is linearly dependent on the active ones if less than this part of it is new.
_DEPENDENT = 1e-9


@numba.njit(cache=True)
def _most_violated(
    currents: np.ndarray, limits: np.ndarray, skipped: np.ndarray,
) -> tuple[int, float]:
    """Return the coil furthest beyond its limit that is not skipped, or −1, and its sign."""
    worst, coil = _AT, -1
    for k in range(len(currents)):
        excess = abs(currents[k]) / limits[k] - 1
        if not skipped[k] and excess > worst:
            worst, coil = excess, k
    return coil, math.copysign(1.0, currents[coil])


@numba.njit(cache=True)
def _let_go(prices: np.ndarray, rates: np.ndarray, count: int) -> tuple[int, float]:
    """Return the first active limit whose multiplier reaches zero, or −1, and the step."""
    step, first = math.inf, -1
    for j in range(count):
        if rates[j] > 0 and prices[j] / rates[j] < step:
            step, first = prices[j] / rates[j], j
    return first, step


@numba.njit(cache=True)
def _split(vector: np.ndarray, basis: np.ndarray, count: int, parts: np.ndarray) -> None:
    """Write a vector's components along the first rows of a basis; leave the remainder in it.

    Done twice, so that the remainder is orthogonal to rounding (Kahan).
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
    """Return the shortest mixture at all active limits, free of the rounding of earlier steps."""
    _decompose(normals, count, basis, triangle)
    mixture, parts = np.zeros(basis.shape[1]), np.zeros(count)
    for j in range(count):
        parts[j] = (bounds[j] - np.dot(triangle[j, :j], parts[:j])) / triangle[j, j]
        mixture += parts[j] * basis[j]
    return mixture


@numba.njit(cache=True)
def within_limits(currents: np.ndarray, spare: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the least-power currents (N,) [A] within their limits.

    Some combination of the inputs must lie within the limits; an excess of rounding is cut off.

    Parameters
    ----------
    currents : (N,) array [A]
        Least-power currents without limits.
    spare : (N, S) array
        Directions that may be added, orthonormal in the heat.
    limits : (N,) array [A]
        Largest absolute current of each coil.

    Returns
    -------
    ndarray, shape (N,)
        Currents [A].
    """
    count, width = spare.shape
    held = np.zeros(count, np.int64)  # coils at their limits, in the order of the arrays below
    normals, bounds, prices = np.zeros((count, width)), np.zeros(count), np.zeros(count)
    basis, triangle = np.zeros((count, width)), np.zeros((count, count))
    rates, mixture = np.zeros(count), np.zeros(width)
    skipped, number = np.zeros(count, np.bool_), 0
    for _ in range(4 * count):  # each coil once, seldom twice; bounded in spite of rounding
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
