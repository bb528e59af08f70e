"""Colour: the weighted sum of red, green and blue that shows the taught bodies best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.errors import InputError

_TELLS = 2.0
"""Choice: least gain of separation over brightness; codecs blur and coarsen colour."""

_CLEAR = 3.0
"""Choice: standard deviations from which two spots differ in colour."""

_SPOT, _AROUND = 5, 201
"""Choices: pixels across the sample of a body's colour, and of the light around it."""

_DIRECTIONS = 2000
"""Choice: weightings of the three colours that are tried."""

_BRIGHTNESS = np.array([0.114, 0.587, 0.299])
"""Weights of blue, green and red in brightness (ITU-R BT.601)."""

Weights = tuple[float, float, float]
"""Weights of red, green and blue."""


@dataclass(frozen=True)
class Spot:
    """Point given by a person in a `picture` (H, W, 3), blue first, at `x`, `y` [px].

    It is of a `kind`, or, if that is None, something else.
    """

    picture: np.ndarray
    x: float
    y: float
    kind: str | None


def weighted(picture: np.ndarray, weights: Weights) -> np.ndarray:
    """Convert a `picture` (H, W, 3 or 4), blue first, to grey (H, W) of its depth by `weights`.

    Their absolute values count as shares; the middle of the scale stays. Raises InputError for a
    picture without colours.

    Parameters
    ----------
    picture : ndarray, shape (H, W, 3)
        The picture, or (H, W, 4).
    weights : Weights
        Weights of the colours.

    Returns
    -------
    ndarray, shape (H, W)
        Grey values.
    """
    import cv2

    if picture.ndim != 3:
        raise InputError('colour', 'expected colour images, as in the film from which the '
                                   'kinds were learned; these are grey')
    shares = np.array(weights[::-1]) / np.sum(np.abs(weights))
    matrix = np.zeros((1, picture.shape[2] + 1))
    matrix[0, :3] = shares
    matrix[0, -1] = np.iinfo(picture.dtype).max / 2 * (1 - shares.sum())
    return np.asarray(cv2.transform(picture, matrix))


def telling_weights(spots: Sequence[Spot]) -> tuple[Weights, float] | None:
    """Return the weights that separate the `spots` best, and the gain over brightness.

    They separate the spots from the light around and, for different kinds, from each other, in
    standard deviations of all pixels, so that other objects are suppressed. None if brightness
    does as well, to a factor of two.

    Parameters
    ----------
    spots : sequence of Spot
        The spots.

    Returns
    -------
    tuple[Weights, float] or None
        Weights and gain, or None.
    """
    apart = [np.empty((0, 3))]
    scatter = np.eye(3) / 12  # variance of rounding
    for picture in {id(spot.picture): spot.picture for spot in spots}.values():
        mine = [spot for spot in spots if spot.picture is picture]
        if picture.ndim != 3 or not all(_inside(spot) for spot in mine):
            return None
        local = _local(picture)
        shown = _spots(mine, local)
        scatter = scatter + _scatter(local, shown[[spot.kind is not None for spot in mine]])
        apart.append(_differences(mine, shown))
    differences = np.vstack(apart)
    values, axes = np.linalg.eigh(scatter)
    whiten = axes / np.sqrt(values)
    directions = _half_sphere() @ whiten.T
    best = directions[np.argmax(np.sum(_information(directions, differences, scatter), axis=1))]
    by_colour, usual = _information(np.array([best, _BRIGHTNESS]), differences, scatter)
    told = by_colour > np.log1p(_CLEAR**2) / 2
    if not told.any():
        return None
    gain = float(np.exp(np.mean((by_colour - usual)[told])))
    if gain < _TELLS:
        return None
    best = best / np.sum(np.abs(best)) * np.sign(best[np.argmax(np.abs(best))])
    blue, green, red = (round(float(share), 3) for share in best)
    return (red, green, blue), gain


def _inside(spot: Spot) -> bool:
    height, width = spot.picture.shape[:2]
    return -0.5 <= spot.x < width - 0.5 and -0.5 <= spot.y < height - 0.5


def _local(picture: np.ndarray) -> np.ndarray:
    """Return the difference (H, W, 3) of pixels from the light around them."""
    import cv2

    colours = picture[..., :3].astype(np.float32)
    return np.asarray(colours - cv2.blur(colours, (_AROUND, _AROUND)))


def _spots(spots: list[Spot], local: np.ndarray) -> np.ndarray:
    """Return the colours (S, 3) of `spots`."""
    import cv2

    smooth = cv2.blur(local, (_SPOT, _SPOT))
    return np.array([smooth[round(spot.y), round(spot.x)] for spot in spots])


def _scatter(local: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of pixels that are unlike what is `shown` (S, 3)."""
    pixels = local[::3, ::3].reshape(-1, 3)
    alike = np.zeros(len(pixels), bool)
    for colour in shown:
        alike |= np.sum((pixels - colour) ** 2, axis=1) < np.sum(colour**2) / 4
    return np.asarray(np.cov(pixels[~alike].T))


def _differences(spots: list[Spot], shown: np.ndarray) -> np.ndarray:
    """Return the colours (P, 3) to be distinguished in one picture, pairwise."""
    kinds = [spot.kind for spot in spots]
    pairs = [shown[j] for j, kind in enumerate(kinds) if kind is not None]
    pairs += [shown[j] - shown[k] for j in range(len(spots)) for k in range(j)
              if kinds[j] != kinds[k]]
    return np.array(pairs).reshape(-1, 3)


def _information(directions: np.ndarray, differences: np.ndarray, scatter: np.ndarray
                 ) -> np.ndarray:
    """Return ½ ln(1 + d′²) (D, P) of each difference along each of `directions` (D, 3)."""
    spread = np.einsum('di,ij,dj->d', directions, scatter, directions)
    return np.asarray(np.log1p((directions @ differences.T) ** 2 / spread[:, None]) / 2)


def _half_sphere() -> np.ndarray:
    """Return evenly spread directions (D, 3): a spiral by the golden angle."""
    k = np.arange(_DIRECTIONS)
    z = (k + 0.5) / _DIRECTIONS
    around = np.pi * (3 - np.sqrt(5)) * k
    flat = np.sqrt(1 - z * z)
    return np.column_stack([flat * np.cos(around), flat * np.sin(around), z])
