"""Interlaced pictures: even and odd rows show two times, so that moving objects look combed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

_STEP = 12.0
"""Choice: least difference to the rows above and below that counts as combed [grey of 255]."""

_OFTEN = 4.0
"""Choice: how much more often adjacent rows must be combed than rows of one field."""

_LEAST = 30
"""Choice: fewer combed pixels in all pictures count as chance."""


def interlaced(pictures: Iterable[np.ndarray]) -> bool:
    """Return whether `pictures` (H, W), some time apart, are interlaced.

    Where something moved between the fields, a row differs from both its neighbours in the same
    direction. Real structures, noise and stripes do so within one field as well.

    Parameters
    ----------
    pictures : iterable of ndarray
        Pictures (H, W).

    Returns
    -------
    bool
        Whether the pictures are interlaced.
    """
    combed = striped = 0
    before = None
    for picture in pictures:
        now = np.asarray(picture, np.float32) * (255 / np.iinfo(picture.dtype).max)
        if before is not None and len(now) > 4:
            moved = np.abs(now - before)[2:-2] > _STEP
            combed += int(np.count_nonzero(moved & _outstanding(now, 1)))
            striped += int(np.count_nonzero(moved & _outstanding(now, 2)))
        before = now
    return combed >= _LEAST and combed > _OFTEN * striped


def _outstanding(grey: np.ndarray, away: int) -> np.ndarray:
    """Return where a row is above, or below, both rows at distance `away`, shape (H − 4, W)."""
    middle, rows = grey[2:-2], len(grey) - 4
    product = ((middle - grey[2 - away:2 - away + rows])
               * (middle - grey[2 + away:2 + away + rows]))
    return np.asarray(product > _STEP**2)


def one_field(picture: np.ndarray) -> np.ndarray:
    """Return `picture` (H, W) or (H, W, C) with its odd rows interpolated from the even ones.

    Parameters
    ----------
    picture : ndarray
        The picture.

    Returns
    -------
    ndarray
        The picture, of the same shape.
    """
    whole = picture.copy()
    above, below = picture[:-1:2], picture[2::2]
    whole[1:2 * len(below):2] = (above[:len(below)].astype(np.uint32) + below + 1) // 2
    if len(picture) % 2 == 0:
        whole[-1] = picture[-2]
    return whole
