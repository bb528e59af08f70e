"""Block means of a picture, its illumination, peaks, and pixel noise."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.refine.fit import FAST

_LEAST_NOISE = 0.3
"""Grey levels: rounding to whole levels has a standard deviation of 1/√12."""

_MEDIAN = 5
"""Choice: cells across the neighbourhood whose median is the illumination of a cell."""


def block_mean(image: np.ndarray, size: int) -> np.ndarray:
    """Return means (H // `size`, W // `size`) float32 of an `image` over square blocks.

    Incomplete blocks are left out.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The picture.
    size : int
        Side of a block [px].

    Returns
    -------
    ndarray
        Means, float32 [grey].
    """
    mean = np.empty((image.shape[0] // size, image.shape[1] // size), np.float32)
    block_mean_into(mean, image, size, 0)
    return mean


@numba.njit(cache=True, fastmath=FAST)
def block_mean_into(mean, image, size, pad):  # type: ignore[no-untyped-def]
    """Write `block_mean` of an `image`, blocks of `size` px, to `mean` with a margin `pad`.

    Parameters
    ----------
    mean
        Array that receives the means.
    image : ndarray, shape (H, W)
        The picture.
    size
        Side of a block [px].
    pad
        Margin of `mean`, in blocks.
    """
    scale = np.float32(1.0 / (size * size))
    # Unsigned indices cannot wrap around, which lets the compiler vectorise.
    count, to = numba.uintp(mean.shape[1] - 2 * pad), numba.uintp(pad)
    line = np.empty(count * size, np.float32)
    for j in range(mean.shape[0] - 2 * pad):
        line[:] = 0
        for dy in range(size):
            source = numba.uintp(j * size + dy)
            for i in range(numba.uintp(line.size)):
                line[i] += image[source, i]
        _narrow(line, size, scale, mean[pad + j], to, count)


@numba.njit(cache=True, fastmath=FAST)
def _narrow(line, size, scale, mean, start, count):  # type: ignore[no-untyped-def]
    """Sum and scale neighbours; the usual sizes with strides known to the compiler."""
    if size == 1:
        for i in range(count):
            mean[start + i] = line[i]
    elif size == 2:
        for i in range(count):
            mean[start + i] = (line[2 * i] + line[2 * i + 1]) * scale
    elif size == 3:
        for i in range(count):
            mean[start + i] = (line[3 * i] + line[3 * i + 1] + line[3 * i + 2]) * scale
    else:
        for i in range(count):
            total = np.float32(0.0)
            for dx in range(size):
                total += line[i * size + dx]
            mean[start + i] = total * scale


def background(image: np.ndarray, spacing: int) -> np.ndarray:
    """Return the illumination (H // `spacing`, W // `spacing`) of an `image`, without particles.

    It is the median of 5×5 block means in cells of `spacing` px. A particle as wide as a cell
    covers at most a quarter of the cells of such a neighbourhood, so that the median ignores it.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The picture.
    spacing : int
        Side of a cell [px].

    Returns
    -------
    ndarray
        Illumination of each cell [grey].
    """
    import cv2

    if min(image.shape) < spacing:
        return np.full((1, 1), np.median(image), np.float32)
    return np.atleast_2d(cv2.medianBlur(block_mean(image, spacing), _MEDIAN))


@numba.njit(cache=True)
def peaks(response, shrink, least, separation):  # type: ignore[no-untyped-def]
    """Return rows (N, 3) of x, y [px], value of the maxima of a `response` above `least`.

    A maximum is the highest value within ±`separation` cells of `shrink` px.

    Parameters
    ----------
    response : ndarray, shape (h, w)
        The response.
    shrink
        Size of a cell [px].
    least
        Least value.
    separation
        Half of the side of the neighbourhood, in cells.
    """
    found = []
    crest = np.empty(response.shape[1], np.uint8)
    for y in range(1, response.shape[0] - 1):
        _crests(response[y - 1], response[y], response[y + 1], least, crest)
        for x in range(1, len(crest) - 1):
            if crest[x] and _highest(response, x, y, separation):
                found.append(_top(response, x, y))
    rows = np.empty((len(found), 3))
    for k in range(len(found)):
        x, y, value = found[k]
        rows[k, 0], rows[k, 1] = (x + 0.5) * shrink - 0.5, (y + 0.5) * shrink - 0.5
        rows[k, 2] = value
    return rows


@numba.njit(cache=True)
def _top(response, x, y):  # type: ignore[no-untyped-def]
    """Return position (by a parabola) and value of a maximum."""
    value = response[y, x]
    bend_x = response[y, x + 1] - 2 * value + response[y, x - 1]
    bend_y = response[y + 1, x] - 2 * value + response[y - 1, x]
    ox = (response[y, x - 1] - response[y, x + 1]) / 2 / min(bend_x, -1e-9)
    oy = (response[y - 1, x] - response[y + 1, x]) / 2 / min(bend_y, -1e-9)
    return x + min(max(ox, -0.5), 0.5), y + min(max(oy, -0.5), 0.5), value


@numba.njit(cache=True)
def _crests(above, line, below, least, crest):  # type: ignore[no-untyped-def]
    """Mark cells of a line above `least` that are no lower than their four neighbours."""
    for x in range(numba.uintp(1), numba.uintp(line.size - 1)):
        value = line[x]
        crest[x] = ((value > least) & (value >= line[x - 1]) & (value >= line[x + 1])
                    & (value >= above[x]) & (value >= below[x]))


@numba.njit(cache=True)
def _highest(response, x, y, separation):  # type: ignore[no-untyped-def]
    """Return whether no cell within ±`separation` is higher; of equal ones, the first counts."""
    height, width = response.shape
    value = response[y, x]
    for dy in range(max(-separation, -y), min(separation, height - 1 - y) + 1):
        for dx in range(max(-separation, -x), min(separation, width - 1 - x) + 1):
            other = response[y + dy, x + dx]
            if other > value or (other == value and (dy, dx) < (0, 0)):
                return False
    return True


def spread(response: np.ndarray) -> float:
    """Return the standard deviation of the noise of a `response`, from the median.

    Parameters
    ----------
    response : ndarray
        The response.

    Returns
    -------
    float
        The standard deviation.
    """
    sample = response[1::4, 1::4]
    middle = np.median(sample)
    return 1.4826 * float(np.median(np.abs(sample - middle)))


@numba.njit(cache=True)
def pixel_noise(image):  # type: ignore[no-untyped-def]
    """Return the standard deviation of the pixel noise [grey] of an `image`.

    It uses second differences: variations slower than from pixel to pixel cancel (J. Immerkær,
    Computer Vision and Image Understanding 64, 300, 1996); the median excludes edges of particles.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The picture.
    """
    rows, columns = max(1, image.shape[0] // 40), max(1, image.shape[1] // 40)
    middle = np.median(_second_differences(image, rows, columns))
    return max(1.4826 * middle / 6, _LEAST_NOISE)


@numba.njit(cache=True)
def _second_differences(image, rows, columns):  # type: ignore[no-untyped-def]
    """Return their magnitudes at every so many pixels, as a flat array."""
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
