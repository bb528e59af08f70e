"""Finding candidates over a whole picture: matched filter, peaks, background."""

from __future__ import annotations

import numba
import numpy as np

from microbot_ros.tracking.appearance import Appearance
from microbot_ros.tracking.fit import FAST

_LEAST_NOISE = 0.3
"""Grey levels: rounding to whole levels has a standard deviation of 1/√12."""


@numba.njit(cache=True, fastmath=FAST)
def block_mean(image, size):  # type: ignore[no-untyped-def]
    """Means (H // size, W // size) float32 over square blocks; a rest at the edge is left out."""
    mean = np.empty((image.shape[0] // size, image.shape[1] // size), np.float32)
    return block_mean_into(mean, image, size)


@numba.njit(cache=True, fastmath=FAST)
def block_mean_into(mean, image, size):  # type: ignore[no-untyped-def]
    """`block_mean` that fills `mean` and returns it."""
    rows, columns = mean.shape
    line = np.empty(columns * size, np.float32)
    scale = np.float32(1.0 / (size * size))
    for j in range(rows):
        line[:] = 0
        for dy in range(size):
            source = image[j * size + dy, :columns * size]
            for i in range(source.size):
                line[i] += source[i]
        if size == 2:
            # The usual case: a known stride lets the compiler use vectors.
            for i in range(numba.uintp(columns)):
                mean[j, i] = (line[2 * i] + line[2 * i + 1]) * scale
            continue
        for i in range(columns):
            total = np.float32(0.0)
            for dx in range(size):
                total += line[i * size + dx]
            mean[j, i] = total * scale
    return mean


def background(image: np.ndarray, spacing: int) -> np.ndarray:
    """The light without particles, in cells of `spacing` px: the median of 5×5 block means.

    A particle as wide as a cell covers at most a quarter of the cells of such a neighbourhood,
    so the median doesn't see it.
    """
    import cv2

    if min(image.shape) < spacing:
        return np.full((1, 1), np.median(image), np.float32)
    return np.atleast_2d(cv2.medianBlur(block_mean(image, spacing), 5))


@numba.njit(cache=True)
def peaks(response, least, separation):  # type: ignore[no-untyped-def]
    """Rows (N, 3) of x, y, value: maxima above `least` within ±`separation` cells, sub-cell."""
    height, width = response.shape
    found = []
    crest = np.empty(width, np.uint8)
    for y in range(1, height - 1):
        _crests(response[y - 1], response[y], response[y + 1], least, crest)
        for x in range(1, width - 1):
            if crest[x] and _highest(response, x, y, separation):
                value = response[y, x]
                bend_x = response[y, x + 1] - 2 * value + response[y, x - 1]
                bend_y = response[y + 1, x] - 2 * value + response[y - 1, x]
                ox = (response[y, x - 1] - response[y, x + 1]) / 2 / min(bend_x, -1e-9)
                oy = (response[y - 1, x] - response[y + 1, x]) / 2 / min(bend_y, -1e-9)
                found.append((x + min(max(ox, -0.5), 0.5), y + min(max(oy, -0.5), 0.5), value))
    rows = np.empty((len(found), 3))
    for k in range(len(found)):
        rows[k, 0], rows[k, 1], rows[k, 2] = found[k]
    return rows


@numba.njit(cache=True)
def _crests(above, line, below, least, crest):  # type: ignore[no-untyped-def]
    """Whether each cell of a line is above `least` and no lower than its four neighbours."""
    for x in range(numba.uintp(1), numba.uintp(line.size - 1)):
        value = line[x]
        crest[x] = ((value > least) & (value >= line[x - 1]) & (value >= line[x + 1])
                    & (value >= above[x]) & (value >= below[x]))


@numba.njit(cache=True)
def _highest(response, x, y, separation):  # type: ignore[no-untyped-def]
    """Whether no cell within ±`separation` is higher; of equals, the first counts."""
    height, width = response.shape
    value = response[y, x]
    for dy in range(max(-separation, -y), min(separation, height - 1 - y) + 1):
        for dx in range(max(-separation, -x), min(separation, width - 1 - x) + 1):
            other = response[y + dy, x + dx]
            if other > value or (other == value and (dy, dx) < (0, 0)):
                return False
    return True


def spread(response: np.ndarray) -> float:
    """Standard deviation of a response's noise, from the median: particles don't count."""
    sample = response[1::4, 1::4]
    middle = np.median(sample)
    return 1.4826 * float(np.median(np.abs(sample - middle)))


def pixel_noise(image: np.ndarray) -> float:
    """Standard deviation of the pixel noise [grey], from a twofold second difference.

    What varies slower than from pixel to pixel drops out (J. Immerkær, Computer Vision and Image
    Understanding 64, 300, 1996); the median makes edges of particles drop out too.
    """
    difference = _second_differences(image, *(max(1, length // 40) for length in image.shape))
    middle = len(difference) // 2
    return max(1.4826 * float(np.partition(difference, middle)[middle]) / 6, _LEAST_NOISE)


@numba.njit(cache=True)
def _second_differences(image, rows, columns):  # type: ignore[no-untyped-def]
    """Their magnitudes about every so many pixels, as a flat array."""
    height, width = image.shape
    down, across = (height - 3) // rows + 1, (width - 3) // columns + 1
    difference = np.empty(down * across, np.float32)
    for m in range(down):
        y = m * rows + 1
        for n in range(across):
            x = n * columns + 1
            corners, sides = 0.0, 0.0
            for dy in (-1, 1):
                corners += float(image[y + dy, x - 1]) + float(image[y + dy, x + 1])
                sides += float(image[y + dy, x]) + float(image[y, x + dy])
            difference[m * across + n] = abs(corners - 2 * sides + 4 * float(image[y, x]))
    return difference


_ENOUGH = 0.97
"""Share of the filter's energy that the separable parts must have."""

_STILL_SHOWN = 0.6
"""Share of a particle's energy that a shrunk picture must keep."""

_LEAST_WIDTH = 2.4
"""Coarse pixels that a particle must be wide, or two side by side look like one."""


def _shrunk(appearance: Appearance, shrink: int, off: float = 0.0) -> np.ndarray:
    """The round picture less its mean, (K, K), in blocks of `shrink` px, the centre `off` px."""
    blocks = 2 * int(np.ceil((appearance.reach_px + off) / shrink - 0.5)) + 1
    fine = np.arange(0.5, blocks * shrink) - blocks * shrink / 2 - off
    u, v = fine[None, :], fine[:, None]
    disc = np.hypot(u, v) <= appearance.reach_px + 0.5
    picture = appearance.draw_round(u, v)
    picture = np.where(disc, picture - np.mean(picture[disc]), 0.0)
    return picture.reshape(blocks, shrink, blocks, shrink).mean(axis=(1, 3))


def _farthest_shrink(appearance: Appearance) -> int:
    """The factor at which a particle keeps enough of its energy in the worst position."""
    whole = np.sum(_shrunk(appearance, 1) ** 2)
    shrink = 1
    while shrink + 1 <= appearance.diameter_px / _LEAST_WIDTH:
        kept = min(
            np.sum(_shrunk(appearance, shrink + 1, off) ** 2) * (shrink + 1) ** 2
            for off in (0.0, (shrink + 1) / 2))
        if kept < _STILL_SHOWN * whole:
            break
        shrink += 1
    return shrink


class MatchedFilter:
    """Search with the learned picture itself, the optimal linear filter for white noise.

    The filter sums to zero and is symmetric, so uniform light and slopes leave no response. It
    is applied as a few separable ones (its singular vectors), on a picture shrunk as far as that
    still shows the particle, wherever it lies between the coarse pixels.
    """

    def __init__(self, appearance: Appearance) -> None:
        self.shrink = _farthest_shrink(appearance)
        template = _shrunk(appearance, self.shrink)
        left, weight, right = np.linalg.svd(template)
        rank = int(np.searchsorted(np.cumsum(weight**2) / np.sum(weight**2), _ENOUGH)) + 1
        sums = weight[:rank] * right[:rank].sum(axis=1)
        # What is left out must not make the filter see the light itself.
        most = np.argmax(np.abs(sums))
        left[:, most] -= sums @ left[:, :rank].sum(axis=0) / (sums[most] * len(left))
        kernel = (left[:, :rank] * weight[:rank]) @ right[:rank]
        # Response in grey levels of contrast: a particle of contrast a responds with a.
        scale = 1 / np.sum(kernel * template)
        self._parts = [
            ((left[:, k] * weight[k] * scale).astype(np.float32), right[k].astype(np.float32))
            for k in range(rank)
        ]
        self.gain = float(scale * np.sqrt(np.sum(kernel**2)))
        self._separation = max(1, round(0.35 * appearance.diameter_px / self.shrink))
        self._pictures = np.empty((0, 0, 0), np.float32)

    def response(self, image: np.ndarray) -> np.ndarray:
        """Contrast [grey] that a particle centred in each cell would have; valid till the next."""
        import cv2

        # Fresh memory for each frame would cost as much as the filters.
        shape = (3, image.shape[0] // self.shrink, image.shape[1] // self.shrink)
        if self._pictures.shape != shape:
            self._pictures = np.empty(shape, np.float32)
        response, part, small = self._pictures
        block_mean_into(small, image, self.shrink)
        for k, (column, row) in enumerate(self._parts):
            cv2.sepFilter2D(small, cv2.CV_32F, row, column, dst=part if k else response)
            if k:
                cv2.add(response, part, dst=response)
        return response

    def candidates(
        self, image: np.ndarray, least_sigma: float, least_contrast: float
    ) -> tuple[np.ndarray, float, float]:
        """Rows (N, 3), x, y [px] and contrast [grey] of maxima; what noise and texture there is.

        That is σ of the pixel noise [grey], and the area [px²] where the response, high or low,
        is more than noise.
        """
        response = self.response(image)
        noise = pixel_noise(image)
        least = least_sigma * noise * self.gain / self.shrink
        found = peaks(response, max(least, least_contrast), self._separation)
        found[:, :2] = (found[:, :2] + 0.5) * self.shrink - 0.5
        sample = np.abs(response[1::4, 1::4])
        return found, noise, np.count_nonzero(sample > least) / sample.size * image.size
