"""Field of a coil, measured or computed on a grid of positions."""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.compiled import numba
from microbot_ros.common.errors import InputError
from microbot_ros.common.tables import Layout, read_table
from microbot_ros.common.units import from_si, to_si
from microbot_ros.magnetics.sources import as_points

COLUMNS = ('x_mm', 'y_mm', 'z_mm', 'bx_mT_per_A', 'by_mT_per_A', 'bz_mT_per_A')
_FIELD = 'field_mT_per_A'

_compiled = numba.njit(cache=True, error_model='numpy')


@_compiled
def _basis(knots: np.ndarray, degree: int, x: float, order: int, weights: np.ndarray) -> int:
    """Write the B-splines that are not 0 at x to weights (4,); return the index of the first.

    Their derivatives if `order` is 1. C. de Boor, J. Approximation Theory 6, 50 (1972).
    """
    last = len(knots) - degree - 2
    first = min(int(np.searchsorted(knots, x, side='right')) - 1, last) - degree
    weights[:] = 0.0
    weights[degree] = 1.0
    for d in range(1, degree + 1):
        for j in range(degree - d, degree + 1):
            i = first + j
            rising = weights[j] / (knots[i + d] - knots[i]) if weights[j] else 0.0
            falling = 0.0
            if j < degree and weights[j + 1]:
                falling = weights[j + 1] / (knots[i + d + 1] - knots[i + 1])
            if order == 1 and d == degree:
                weights[j] = degree * (rising - falling)
            else:
                weights[j] = (x - knots[i]) * rising + (knots[i + d + 1] - x) * falling
    return first


@_compiled
def _spline(points: np.ndarray, knots: tuple[np.ndarray, np.ndarray, np.ndarray],
            coefficients: np.ndarray, orders: tuple[int, int, int], out: np.ndarray) -> None:
    """Write the tensor product of splines along x, y and z to `out` (M, 3), NaN outside the grid.

    `coefficients` (X, Y, Z, 3); `orders` are those of the derivatives, 0 or 1.
    """
    weights = np.empty((3, 4))
    first = np.empty(3, np.int64)
    degrees = np.empty(3, np.int64)
    for axis in range(3):
        degrees[axis] = len(knots[axis]) - coefficients.shape[axis] - 1
    for m in range(len(points)):
        inside = True
        for axis in range(3):
            t, x = knots[axis], points[m, axis]
            inside &= t[0] <= x <= t[-1]
            if inside:
                first[axis] = _basis(t, degrees[axis], x, orders[axis], weights[axis])
        out[m] = 0.0 if inside else np.nan
        if inside:
            for i in range(degrees[0] + 1):
                for j in range(degrees[1] + 1):
                    for k in range(degrees[2] + 1):
                        weight = weights[0, i] * weights[1, j] * weights[2, k]
                        for c in range(3):
                            out[m, c] += weight * coefficients[
                                first[0] + i, first[1] + j, first[2] + k, c]


class FieldMap:
    """Field per ampere between the positions of a grid, by cubic splines; NaN outside.

    Three positions along an axis give a quadratic spline, two a linear one. The gradient is that
    of the splines.

    Parameters
    ----------
    places : tuple of three arrays [m]
        Increasing coordinates of the grid along x, y and z, two or more each.
    field : (X, Y, Z, 3) array [T/A]
        Field per ampere at each position of the grid.
    source : str or Path
        Origin of the map, for messages.

    Raises
    ------
    InputError
        For coordinates that do not increase, and for a field of another shape or not finite.
    """

    def __init__(self, places: tuple[np.ndarray, ...], field: np.ndarray,
                 source: str | Path = 'field_map') -> None:
        from scipy.interpolate import make_interp_spline
        if field.shape != (*map(len, places), 3) or not np.isfinite(field).all():
            raise InputError(source, 'expected a finite field at each place of the grid, an '
                                     f'array of {(*map(len, places), 3)}; received one of '
                                     f'{field.shape}')
        for name, along in zip('xyz', places, strict=True):
            if len(along) < 2 or not (np.isfinite(along).all() and (np.diff(along) > 0).all()):
                raise InputError(source, f'expected two or more places along {name}, ascending')
        knots = []
        for axis, along in enumerate(places):
            spline = make_interp_spline(along, field, min(3, len(along) - 1), axis=axis)
            # SciPy returns the coefficients with the interpolated axis first.
            field = np.moveaxis(spline.c, 0, axis)
            knots.append(spline.t)
        self._knots, self._coefficients = tuple(knots), np.ascontiguousarray(field)
        self._low, self._high = (np.array([along[end] for along in places]) for end in (0, -1))

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return the field [T/A] at `points` (M, 3) [m], shape (M, 3); NaN outside the grid.

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3)
            Field [T/A].
        """
        return self._evaluate(as_points(points), 0, 0, 0)

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m/A] at `points` (M, 3) [m], shape (M, 3, 3); NaN outside the grid.

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3, 3)
            Gradient [T/m/A].
        """
        points = as_points(points)
        return np.stack([self._evaluate(points, *orders)
                         for orders in ((1, 0, 0), (0, 1, 0), (0, 0, 1))], axis=-1)

    def margin(self, point: np.ndarray) -> float:
        """Return the distance [m] from `point` to the nearest side of the grid; < 0 outside.

        Parameters
        ----------
        point : ndarray, shape (3,)
            Point [m].

        Returns
        -------
        float
            Distance [m]; negative outside.
        """
        return float(np.minimum(point - self._low, self._high - point).min())

    def _evaluate(self, points: np.ndarray, *orders: int) -> np.ndarray:
        """Return the derivative of the `orders` along x, y and z, shape (M, 3)."""
        found = np.empty_like(points)
        _spline(points, self._knots, self._coefficients, orders, found)
        return found


def read_field_map(path: str | Path) -> FieldMap:
    """Read a field map from a CSV table of all grid positions, or from the arrays of an NPZ file.

    CSV has the columns `COLUMNS`, with rows and columns in any order. NPZ has `x_mm`, `y_mm`,
    `z_mm` and `field_mT_per_A` (X, Y, Z, 3). Raises InputError naming `path`, and for a table the
    line, for positions that are missing, duplicate or not finite.

    Parameters
    ----------
    path : str or Path
        CSV file to read.

    Returns
    -------
    FieldMap
        The map.
    """
    path = Path(path)
    if path.suffix == '.npz':
        return _from_arrays(path)
    if path.suffix == '.csv':
        return _from_table(path)
    raise InputError(path, 'expected a map with the ending .csv or .npz')


def _from_arrays(path: Path) -> FieldMap:
    names = (*COLUMNS[:3], _FIELD)
    try:
        with path.open('rb') as stream, np.load(stream, allow_pickle=False) as file:
            arrays = [np.asarray(file[name], dtype=float) for name in names]
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile,
            zlib.error) as error:
        raise InputError(path, f'expected an NPZ file with {", ".join(names)} ({error})') from None
    if any(array.ndim != 1 for array in arrays[:3]):
        raise InputError(path, 'expected one dimension in x_mm, y_mm and z_mm')
    places = tuple(to_si('_mm', array) for array in arrays[:3])
    return FieldMap(places, to_si('_mT', arrays[3]), path)


def _from_table(path: Path) -> FieldMap:
    table = read_table(path, Layout(COLUMNS))
    columns = [table.columns[name] for name in COLUMNS]
    places = tuple(np.unique(column) for column in columns[:3])
    at = tuple(np.searchsorted(*pair) for pair in zip(places, columns[:3], strict=True))
    size = tuple(map(len, places))
    index = np.ravel_multi_index(at, size)
    again = np.ones(len(index), bool)
    again[np.unique(index, return_index=True)[1]] = False
    table.refuse(again, 'expected every place once; this one is there already')
    if len(index) < math.prod(size):
        hole = np.unravel_index(np.setdiff1d(np.arange(math.prod(size)), index)[0], size)
        spot = ', '.join(f'{from_si("_mm", along[k]):g}'
                         for along, k in zip(places, hole, strict=True))
        raise InputError(path, f'expected a full grid of {" × ".join(map(str, size))} places; '
                         f'({spot}) mm is missing')
    field = np.empty((len(index), 3))
    field[index] = np.column_stack(columns[3:])
    return FieldMap(places, field.reshape(*size, 3), path)
