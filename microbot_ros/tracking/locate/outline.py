"""Opaque particles of any shape, clumps included, measured by their outline."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.locate.detect import Detections
from microbot_ros.tracking.locate.search import background, block_mean, pixel_noise
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.settings import TrackerSettings

_LOW, _HIGH = 0.35, 0.7
"""Choices: shares of the typical contrast for the outline, and for fully dark (or bright)."""

_SHARP = 0.85
"""Choice: least sharpness of a new particle, in terms of the least quality."""

_LARGEST_CLUMP = 5.0
"""Choice: largest clump, in typical diameters."""

_LONGEST = 4.0
"""Choice: length over width beyond which an object is a hair."""

_LENIENCE = 0.75
"""Choice: share of each requirement that a known particle must still meet."""

_KNOWN = 0.5
"""Choice: diameters from its expectation within which a particle counts as known."""

_LEAST_SIGMA = 1e-3
"""Choice: least error [px] of a centroid, even in a noiseless picture."""

_COUNT, _CORE, _WEIGHT, _WX, _WY, _WXX, _WYY, _WXY, _EDGE_X, _EDGE_Y, _PEAK = range(11)
"""Indices of the sums of a region."""


class OutlineDetector:
    """Detector of connected regions that are dark (or bright), sharp and large enough.

    The position is the centroid of the contrast, capped at the typical one: fully dark pixels
    count fully, edge pixels in part, so that the position is sub-pixel. Defocused debris has no
    core, specks are too small, hairs too long. `appearance` and `settings` as in `RoundDetector`.

    Parameters
    ----------
    appearance : Appearance
        The learned picture.
    settings : TrackerSettings
        Settings of the tracker.
    """

    def __init__(self, appearance: Appearance, settings: TrackerSettings) -> None:
        self.appearance = appearance
        self.remark = ''
        self._shrink = max(1, int(appearance.diameter_px / 10))
        self._spacing = max(4, int(np.ceil(appearance.diameter_px / self._shrink)))
        self._least_sharpness = _SHARP * settings.min_quality
        self._least_diameter = appearance.diameter_px / settings.size_tolerance**2
        self._least_peak = max(0.75 * appearance.contrast_grey, appearance.min_contrast_grey)

    def detect(self, image: np.ndarray, expected: np.ndarray) -> Detections:
        """Return all particles of `image` (H, W).

        Particles near `expected` positions (M, 2) [px] need not be as sharp and as large as new
        ones, so that a particle at the limit does not come and go.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        expected : ndarray, shape (M, 2)
            Predicted positions [px].

        Returns
        -------
        Detections
            The detections.
        """
        sums = self._regions(image)
        good = self._good(sums, 1.0)
        if len(expected):
            places = np.column_stack([sums[:, _WX], sums[:, _WY]]) / sums[:, _WEIGHT, None]
            offset = np.abs((places[:, None] + 0.5) * self._shrink - 0.5 - expected)
            known = np.any(np.all(offset < _KNOWN * self.appearance.diameter_px, axis=2), axis=1)
            good |= known & self._good(sums, _LENIENCE)
        return self._detections(sums[good], pixel_noise(image) / self._shrink)

    def _regions(self, image: np.ndarray) -> np.ndarray:
        """Return the sums of the regions of an `image`."""
        import cv2

        contrast = self._contrast(image)
        typical = self.appearance.contrast_grey
        mask = (contrast > _LOW * typical).view(np.uint8)
        count, labels = cv2.connectedComponents(mask, connectivity=8, ltype=cv2.CV_32S)
        sums: np.ndarray = _sums(contrast, labels, count, typical)[1:]
        return sums

    def _contrast(self, image: np.ndarray) -> np.ndarray:
        """Return the contrast of the typical sign (h, w), shrunk."""
        import cv2

        small = block_mean(image, self._shrink)
        light = cv2.resize(
            background(small, self._spacing), None, fx=self._spacing, fy=self._spacing,
            interpolation=cv2.INTER_LINEAR)
        rows, columns = np.subtract(small.shape, light.shape)
        light = cv2.copyMakeBorder(light, 0, rows, 0, columns, cv2.BORDER_REPLICATE)
        first, second = (light, small) if self.appearance.dark else (small, light)
        contrast: np.ndarray = cv2.subtract(first, second)
        return contrast

    def _good(self, sums: np.ndarray, share: float) -> np.ndarray:
        """Return whether each region meets a `share` of the requirements."""
        diameter = _diameter(sums) * self._shrink
        good = (diameter >= share * self._least_diameter) & (_elongation(sums) <= _LONGEST)
        good &= diameter <= _LARGEST_CLUMP * self.appearance.diameter_px
        good &= _sharpness(sums) >= share * self._least_sharpness
        return good & (sums[:, _PEAK] >= share * self._least_peak)

    def _detections(self, sums: np.ndarray, noise: float) -> Detections:
        weight = sums[:, _WEIGHT]
        places = np.column_stack([sums[:, _WX], sums[:, _WY]]) / weight[:, None]
        edge = (sums[:, _EDGE_X] + sums[:, _EDGE_Y]) / 2
        sigma = noise / self.appearance.contrast_grey * np.sqrt(edge) / weight * self._shrink
        return Detections(
            xy=(places + 0.5) * self._shrink - 0.5,
            sigma=np.maximum(sigma, _LEAST_SIGMA),
            theta=np.full(len(sums), np.nan),
            contrast=sums[:, _PEAK],
            radius=_diameter(sums) * self._shrink / 2,
            quality=_sharpness(sums),
            kind=np.zeros(len(sums), int),
        )

    def irregularity(self, image: np.ndarray) -> float:
        """Return how far the particles of an `image` are from equal discs; 0 if there are none.

        The spread of ln(diameter) or the typical ln(length/width), whichever is larger.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.

        Returns
        -------
        float
            The irregularity.
        """
        sums = self._regions(image)
        good = self._good(sums, 1.0)
        if not np.any(good):
            return 0.0
        size = np.log(_diameter(sums[good]))
        spread = 1.4826 * float(np.median(np.abs(size - np.median(size))))
        return max(spread, math.log(float(np.median(_elongation(sums[good])))))


def _diameter(sums: np.ndarray) -> np.ndarray:
    """Return the diameter of the disc of equal area, in shrunk pixels."""
    return np.sqrt(4 * sums[:, _WEIGHT] / np.pi)


def _sharpness(sums: np.ndarray) -> np.ndarray:
    """Return the share of a region with full contrast: near 1 in focus, 0 for a blur."""
    return sums[:, _CORE] / sums[:, _COUNT]


def _elongation(sums: np.ndarray) -> np.ndarray:
    """Return length over width of the ellipse with equal second moments."""
    weight = sums[:, _WEIGHT]
    x, y = sums[:, _WX] / weight, sums[:, _WY] / weight
    xx = sums[:, _WXX] / weight - x**2 + 1 / 12
    yy = sums[:, _WYY] / weight - y**2 + 1 / 12
    xy = sums[:, _WXY] / weight - x * y
    root = np.sqrt((xx - yy) ** 2 / 4 + xy**2)
    middle = (xx + yy) / 2
    length: np.ndarray = np.sqrt((middle + root) / np.maximum(middle - root, 1 / 12))
    return length


@numba.njit(cache=True)
def _sums(contrast, labels, count, typical):  # type: ignore[no-untyped-def]
    """Return moments (count, 11) of every labelled region, in order of the names above."""
    sums = np.zeros((count, 11))
    for j in range(labels.shape[0]):
        for i in range(labels.shape[1]):
            k = labels[j, i]
            if k == 0:
                continue
            value, x, y = contrast[j, i], i, j
            w = min(value / typical, 1.0)
            row = sums[k]
            row[_COUNT] += 1
            row[_CORE] += value > _HIGH * typical
            row[_WEIGHT] += w
            row[_WX] += w * x
            row[_WY] += w * y
            row[_WXX] += w * x * x
            row[_WYY] += w * y * y
            row[_WXY] += w * x * y
            row[_PEAK] = max(row[_PEAK], value)
    for j in range(labels.shape[0]):
        for i in range(labels.shape[1]):
            k = labels[j, i]
            if k > 0 and contrast[j, i] < typical:
                row = sums[k]
                row[_EDGE_X] += (i - row[_WX] / row[_WEIGHT]) ** 2
                row[_EDGE_Y] += (j - row[_WY] / row[_WEIGHT]) ** 2
    return sums
