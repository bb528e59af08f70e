"""Interlaced pictures: even and odd rows show two moments, so that what moves is combed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

_STEP = 12.0
"""Least difference to the rows above and below that is a comb's [grey levels of 255]."""

_OFTEN = 4.0
"""How much more often than rows of one moment the rows of a picture must differ so."""

_LEAST = 30
"""Pixels in all pictures: fewer are chance."""


def interlaced(pictures: Iterable[np.ndarray]) -> bool:
    """Whether `pictures` (H, W), some time apart, are interlaced.

    Where something moved, rows differ from both neighbours alike. What is really there, noise and
    stripes, is as striped in the rows of one moment.
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
    """Whether in each pixel (H − 4, W) a row is above, or below, both rows so far `away`."""
    middle, rows = grey[2:-2], len(grey) - 4
    product = ((middle - grey[2 - away:2 - away + rows])
               * (middle - grey[2 + away:2 + away + rows]))
    return np.asarray(product > _STEP**2)


def one_field(picture: np.ndarray) -> np.ndarray:
    """The `picture` (H, W) or (H, W, C) of the moment of its even rows: between them, their mean.
    """
    whole = picture.copy()
    above, below = picture[:-1:2], picture[2::2]
    whole[1:2 * len(below):2] = (above[:len(below)].astype(np.uint32) + below + 1) // 2
    if len(picture) % 2 == 0:
        whole[-1] = picture[-2]
    return whole
