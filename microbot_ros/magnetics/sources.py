"""Sources of field per ampere: circular loops, polylines, and other sources moved into place.

Workspace frame: origin at the workspace centre, x right, y up, z towards the camera, right-handed.
Fields are linear in the current, so everything here is per ampere. A gradient is
`[..., i, j] = ∂Bᵢ/∂xⱼ`. Points on a wire, where the field is infinite, and points that are not
finite give NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from microbot_ros.common.errors import InputError


class Source(Protocol):
    """Field of a coil that carries 1 A."""

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return the field [T/A] at `points` (M, 3) [m], shape (M, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3)
            Field [T/A].
        """

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m/A] at `points` (M, 3) [m], shape (M, 3, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3, 3)
            Gradient [T/m/A].
        """

    def margin(self, point: np.ndarray) -> float:
        """Return the distance [m] from `point` (3,) [m] to the wire or to the edge of a field map.

        Negative outside a map; infinite if no end is known.

        Parameters
        ----------
        point : ndarray, shape (3,)
            Point [m].

        Returns
        -------
        float
            Distance [m].
        """


def as_points(points: ArrayLike) -> np.ndarray:
    """Return points as a contiguous (M, 3) array; (M, 2) lie in z = 0. Otherwise InputError.

    Parameters
    ----------
    points : ArrayLike, shape (M, 3)
        Points [m]; (M, 2) lie in the plane z = 0.

    Returns
    -------
    ndarray, shape (M, 3)
        Points [m].
    """
    array = np.ascontiguousarray(points, dtype=float)
    if array.ndim == 2 and array.shape[1] == 2:
        array = np.column_stack([array, np.zeros(len(array))])
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError('points', f'expected an (M, 3) or (M, 2) array; received {array.shape}')
    return array


class Loop:
    """Circular loop of wire.

    Positive current runs counterclockwise seen from the tip of the axis: the field at the centre
    points along the axis.

    Parameters
    ----------
    radius : float [m]
        Radius of the loop.
    centre : (3,) array [m]
        Centre of the loop.
    axis : (3,) array
        Direction of the axis, of any length but zero.
    turns : float
        Factor of the field; negative for the opposite winding direction.

    Raises
    ------
    InputError
        For a radius that is not positive, an axis of zero length, and values that are not finite.
    """

    def __init__(
        self, radius: float, centre: ArrayLike, axis: ArrayLike, turns: float = 1.0,
    ) -> None:
        if not 0 < radius < math.inf:
            raise InputError('radius', f'expected a positive, finite length; received {radius} m')
        self._wire = (_finite('centre', centre), _frame(_finite('axis', axis)), float(radius),
                      float(_finite('turns', turns)))

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return the field [T/A] at `points` (M, 3) [m], shape (M, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3)
            Field [T/A].
        """
        from microbot_ros.magnetics.loop import loop_field
        return _fill(loop_field, points, (3,), *self._wire)

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m/A] at `points` (M, 3) [m], shape (M, 3, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3, 3)
            Gradient [T/m/A].
        """
        from microbot_ros.magnetics.loop import loop_gradient
        return _fill(loop_gradient, points, (3, 3), *self._wire)

    def margin(self, point: np.ndarray) -> float:
        """Return the distance [m] from `point` (3,) [m] to the wire.

        Parameters
        ----------
        point : ndarray, shape (3,)
            Point [m].

        Returns
        -------
        float
            Distance [m].
        """
        centre, axes, radius, _ = self._wire
        x, y, z = (point - centre) @ axes
        return math.hypot(math.hypot(x, y) - radius, z)


class Polyline:
    """Straight segments of wire through vertices.

    An open polyline is not a complete circuit: its field has curl off the wire and its gradient is
    not symmetric. Repeat the first vertex at the end to close it.

    Parameters
    ----------
    vertices : (V, 3) array [m]
        Ends of the segments, in the direction of positive current.
    turns : float
        Factor of the field.

    Raises
    ------
    InputError
        For fewer than two vertices, two equal neighbours, and values that are not finite.
    """

    def __init__(self, vertices: ArrayLike, turns: float = 1.0) -> None:
        corners = _finite('vertices', as_points(vertices))
        if len(corners) < 2 or not np.any(np.diff(corners, axis=0), axis=1).all():
            raise InputError('vertices', 'expected two or more, no two neighbours equal')
        self._wire = (corners, float(_finite('turns', turns)))

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return the field [T/A] at `points` (M, 3) [m], shape (M, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3)
            Field [T/A].
        """
        from microbot_ros.magnetics.polyline import polyline_field
        return _fill(polyline_field, points, (3,), *self._wire)

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m/A] at `points` (M, 3) [m], shape (M, 3, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3, 3)
            Gradient [T/m/A].
        """
        from microbot_ros.magnetics.polyline import polyline_gradient
        return _fill(polyline_gradient, points, (3, 3), *self._wire)

    def margin(self, point: np.ndarray) -> float:
        """Return the distance [m] from `point` (3,) [m] to the wire.

        Parameters
        ----------
        point : ndarray, shape (3,)
            Point [m].

        Returns
        -------
        float
            Distance [m].
        """
        starts, sides = self._wire[0][:-1], np.diff(self._wire[0], axis=0)
        along = np.einsum('vi,vi->v', point - starts, sides) / np.square(sides).sum(axis=1)
        nearest = starts + np.clip(along, 0, 1)[:, None] * sides
        return float(np.linalg.norm(point - nearest, axis=1).min())


class Placed:
    """Another `source` with its origin moved to `centre` (3,) [m] and its field times `factor`.

    Raises InputError for values that are not finite.

    Parameters
    ----------
    source : Source
        The other source.
    centre : ArrayLike
        New place of its origin (3,) [m].
    factor : float
        Factor on its field.
    """

    def __init__(self, source: Source, centre: ArrayLike, factor: float = 1.0) -> None:
        self._source, self._centre = source, _finite('centre', centre)
        self._factor = float(_finite('factor', factor))

    def field_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return the field [T/A] at `points` (M, 3) [m], shape (M, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3)
            Field [T/A].
        """
        return self._factor * self._source.field_per_ampere(as_points(points) - self._centre)

    def gradient_per_ampere(self, points: ArrayLike) -> np.ndarray:
        """Return ∂Bᵢ/∂xⱼ [T/m/A] at `points` (M, 3) [m], shape (M, 3, 3).

        Parameters
        ----------
        points : ArrayLike, shape (M, 3)
            Points [m]; (M, 2) lie in the plane z = 0.

        Returns
        -------
        ndarray, shape (M, 3, 3)
            Gradient [T/m/A].
        """
        return self._factor * self._source.gradient_per_ampere(as_points(points) - self._centre)

    def margin(self, point: np.ndarray) -> float:
        """Return `Source.margin` of the source at `point` (3,) [m].

        Parameters
        ----------
        point : ndarray, shape (3,)
            Point [m].

        Returns
        -------
        float
            Distance [m].
        """
        return self._source.margin(point - self._centre)


def _fill(
    kernel: Callable[..., None], points: ArrayLike, shape: tuple[int, ...], *wire: object,
) -> np.ndarray:
    array = as_points(points)
    out = np.empty((len(array), *shape))
    kernel(array, *wire, out)
    return out


def _finite(name: str, value: ArrayLike) -> np.ndarray:
    array = np.array(value, dtype=float, order='C')
    if not np.isfinite(array).all():
        raise InputError(name, f'expected finite numbers; received {value!r}')
    return array


def _frame(axis: np.ndarray) -> np.ndarray:
    """Return a right-handed orthonormal frame with `axis` as its last column."""
    length = np.linalg.norm(axis)
    if not length > 0:
        raise InputError('axis', 'expected a direction; received a vector of no length')
    z = axis / length
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.ascontiguousarray(np.column_stack([x, np.cross(z, x), z]))
