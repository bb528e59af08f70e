"""Currents for a field and a pull together, without limits: the arithmetic of `Allocator.actuate`.

Compiled, since thirty small steps of NumPy take longer than a period of control leaves for them.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.compiled import numba


@numba.njit(cache=True)
def together(
    field: np.ndarray, pull: np.ndarray, background: np.ndarray, unlimited: np.ndarray,
    spare: np.ndarray, along: np.ndarray, least: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The cheapest currents (N,) [A] for a field (axes,) [T] and a pull (axes,) [T/m].

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
