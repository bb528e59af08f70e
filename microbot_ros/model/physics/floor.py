"""Factors by which the drag of a sphere increases near a plane floor.

All take the height h of the centre above the floor and the radius a, in any common unit, as
numbers or arrays that broadcast. They return the drag over that in bulk fluid, which is 1 far
away. ValueError unless the height is finite and larger than the radius.

Two of them diverge at contact as a logarithm of the gap, by lubrication (Goldman, Cox & Brenner,
Chemical Engineering Science 22, 637 (1967); constants and next terms after Chaoui & Feuillebois,
Quarterly Journal of Mechanics and Applied Mathematics 56, 381 (2003)). A polynomial in s = a/h is
added so that the sum agrees with Faxén's series far away, to order s³, and with lubrication at
contact. The remaining error in between is stated for each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_CLOSEST = 10e-9
"""Smallest gap [m] that charged surfaces keep in water (Israelachvili, "Intermolecular and surface
forces", chapter 14)."""

_TERMS = np.arange(1.0, 101.0)
"""Terms of Jeffery's series. Choice: with the bound of the rest, accurate to 1e-4."""

_REST = 1.2020569031595942 - float((_TERMS**-3).sum())  # of ζ(3)
"""Sum of n⁻³ beyond these terms, from ζ(3)."""


def sliding_factor(height: ArrayLike, radius: ArrayLike) -> np.ndarray:
    """Return the factor for motion along the floor without rotation.

    1 + 9a/16h + … (Faxén); 8/15 ln(a/gap) + 0.9543 at contact. It is within 0.1 % of the exact
    solution (O'Neill, Mathematika 11, 67 (1964)) at all heights. A sphere that is free to roll has
    less drag, by 0.3 % at a gap of a/10 and by 2 % at a/300.

    Parameters
    ----------
    height : array_like
        Height h of the centre [m].
    radius : array_like
        Radius a [m].

    Returns
    -------
    ndarray
        Factor, at least 1.
    """
    return _joined(_nearness(height, radius), (8 / 15, 64 / 375), 0.9543,
                   (1.0, 9 / 16, 81 / 256, 217 / 4096))


def rolling_factor(height: ArrayLike, radius: ArrayLike) -> np.ndarray:
    """Return the factor for rotation about an axis along the floor.

    1 + 5a³/16h³ + …; 2/5 ln(a/gap) + 0.3709 at contact. It is within 0.6 % of the exact solution
    (Dean & O'Neill, Mathematika 10, 13 (1963)).

    Parameters
    ----------
    height : array_like
        Height h of the centre [m].
    radius : array_like
        Radius a [m].

    Returns
    -------
    ndarray
        Factor, at least 1.
    """
    return _joined(_nearness(height, radius), (2 / 5, 66 / 125), 0.3709, (1.0, 0.0, 0.0, 5 / 16))


def spinning_factor(height: ArrayLike, radius: ArrayLike) -> np.ndarray:
    """Return the factor for rotation about the normal of the floor, as of a heading in the plane.

    The exact sinh³α Σ 1/sinh³(nα), cosh α = h/a (Jeffery, Proceedings of the London Mathematical
    Society 14, 327 (1915)), by its first 100 terms and a bound for the rest: accurate to 1e-4. 1 +
    a³/8h³ + …; 1.202 at contact.

    Parameters
    ----------
    height : array_like
        Height h of the centre [m].
    radius : array_like
        Radius a [m].

    Returns
    -------
    ndarray
        Factor, from 1 to 1.202.
    """
    alpha = np.arccosh(1 / _nearness(height, radius))[..., None]
    # e^{(1−n)α} (1 − e^{−2α}) / (1 − e^{−2nα}) overflows nowhere.
    ratio = np.exp((1 - _TERMS) * alpha) * np.expm1(-2 * alpha) / np.expm1(-2 * _TERMS * alpha)
    last = ratio[..., -1] * _TERMS[-1]
    factor: np.ndarray = (ratio**3).sum(axis=-1) + _REST * last**3
    return factor


def height_of_drag(factor: float, radius: float) -> float | None:
    """Return the height at which the drag of sliding is a given multiple of that in bulk.

    Parameters
    ----------
    factor : float
        The multiple.
    radius : float
        Radius [m].

    Returns
    -------
    float or None
        Height [m]. None if the factor is not above 1, or needs a gap below 10 nm, which charged
        surfaces keep in water (Israelachvili, "Intermolecular and surface forces", chapter 14).
    """
    closest = radius / (radius + _CLOSEST)
    if not 1 < factor <= sliding_factor(1.0, closest):
        return None
    from scipy.optimize import brentq
    return radius / float(brentq(lambda s: sliding_factor(1.0, s) - factor, 1e-17, closest))


def _nearness(height: ArrayLike, radius: ArrayLike) -> np.ndarray:
    """Return a/h, above 0 and below 1."""
    height, radius = np.asarray(height, float), np.asarray(radius, float)
    if not np.all((radius > 0) & (radius < height) & (height < np.inf)):
        raise ValueError(f'height must be more than the radius {radius} '
                         f'and finite; received {height}')
    return np.asarray(radius / height)


def _joined(s: np.ndarray, lubrication: tuple[float, float], contact: float,
            series: tuple[float, ...]) -> np.ndarray:
    """Return −(p + q(1 − s)) ln(1 − s) plus a polynomial in s, `lubrication` = (p, q).

    The sum has the `series` far away and, beside the logarithm, the value `contact` at s = 1.
    """
    p, q = lubrication
    expanded = [0.0, p + q, *(p / k + q / k - q / (k - 1) for k in range(2, len(series)))]
    coefficients = np.subtract(series, expanded)
    coefficients = np.append(coefficients, contact - coefficients.sum())
    logarithm = (p + q * (1 - s)) * np.log1p(-s)
    factor: np.ndarray = np.polyval(coefficients[::-1], s) - logarithm
    return factor
