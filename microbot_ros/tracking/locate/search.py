"""Looking over a picture, or parts of it: block means, the light, peaks, the pixels' noise.

Parts are boxes, (n, 4) whole numbers: rows y0, x0, y1, x1, the ends left out.
"""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.refine.fit import FAST

_LEAST_NOISE = 0.3
"""Grey levels: rounding to whole levels has a standard deviation of 1/√12."""

_MEDIAN = 5
"""Cells across the neighbourhood whose median is the light of a cell."""


def whole(shape: tuple[int, ...]) -> np.ndarray:
    """The one box (1, 4) that is all of a picture of that `shape` (H, W)."""
    return np.array([[0, 0, shape[0], shape[1]]])


@numba.njit(cache=True)
def grown(boxes, margin, shape):  # type: ignore[no-untyped-def]
    """Boxes with a margin all around, as far as a picture of that shape goes."""
    larger = np.empty_like(boxes)
    for k in range(len(boxes)):
        for axis in range(2):
            larger[k, axis] = min(max(boxes[k, axis] - margin, 0), shape[axis])
            larger[k, axis + 2] = min(max(boxes[k, axis + 2] + margin, 0), shape[axis])
    return larger


@numba.njit(cache=True)
def in_cells(boxes, size, shape):  # type: ignore[no-untyped-def]
    """The cells of `size` px, of a `shape` of (rows, columns), that hold a part of the boxes."""
    cells = np.empty_like(boxes)
    for k in range(len(boxes)):
        for axis in range(2):
            cells[k, axis] = min(boxes[k, axis] // size, shape[axis])
            cells[k, axis + 2] = min(-(-boxes[k, axis + 2] // size), shape[axis])
    return cells


def block_mean(image: np.ndarray, size: int) -> np.ndarray:
    """Means (H // size, W // size) float32 of an `image` over square blocks; a rest is left out.
    """
    mean = np.empty((image.shape[0] // size, image.shape[1] // size), np.float32)
    block_mean_into(mean, image, size, 0, whole(mean.shape))
    return mean


@numba.njit(cache=True, fastmath=FAST)
def block_mean_into(mean, image, size, pad, boxes):  # type: ignore[no-untyped-def]
    """`block_mean` of an `image` over blocks of `size` px, in boxes of cells, into `mean`.

    `mean` has `pad` cells of margin.
    """
    scale = np.float32(1.0 / (size * size))
    for y0, x0, y1, x1 in boxes:
        line = np.empty((x1 - x0) * size, np.float32)
        # Unsigned indices can't wrap around, which lets the compiler use vectors.
        count, start, to = numba.uintp(x1 - x0), numba.uintp(x0 * size), numba.uintp(pad + x0)
        for j in range(y0, y1):
            line[:] = 0
            for dy in range(size):
                source = numba.uintp(j * size + dy)
                for i in range(numba.uintp(line.size)):
                    line[i] += image[source, start + i]
            _narrow(line, size, scale, mean[pad + j], to, count)


@numba.njit(cache=True, fastmath=FAST)
def _narrow(line, size, scale, mean, start, count):  # type: ignore[no-untyped-def]
    """Sums of so many neighbours, scaled; the usual ones with strides that the compiler knows."""
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


class Light:
    """The light without particles, in cells of `spacing` px: the median of 5×5 block means.

    A particle as wide as a cell covers at most a quarter of the cells of such a neighbourhood,
    so the median doesn't see it. Where it isn't asked to look it keeps what it saw last.
    """

    def __init__(self, spacing: int) -> None:
        self._spacing = spacing
        self._cells = np.empty((0, 0), np.float32)

    def look(self, image: np.ndarray, boxes: np.ndarray, margin: int = 0) -> np.ndarray:
        """The light (H // spacing, W // spacing) of an `image`, anew up to `margin` px from the
        `boxes`.
        """
        import cv2

        if min(image.shape) < self._spacing:
            return np.full((1, 1), np.median(image), np.float32)
        shape = (image.shape[0] // self._spacing, image.shape[1] // self._spacing)
        if self._cells.shape != shape:
            self._cells = np.zeros(shape, np.float32)
        _block_mean_near(self._cells, image, self._spacing, margin, boxes)
        return np.atleast_2d(cv2.medianBlur(self._cells, _MEDIAN))


@numba.njit(cache=True)
def _block_mean_near(cells, image, size, margin, boxes):  # type: ignore[no-untyped-def]
    """Block means of all cells that take part in the light near the boxes, between cells too."""
    wide = in_cells(grown(boxes, margin, image.shape), size, cells.shape)
    near = grown(wide, 1 + _MEDIAN // 2, cells.shape)
    block_mean_into(cells, image, size, 0, near)


def background(image: np.ndarray, spacing: int) -> np.ndarray:
    """The light without particles in all of an `image`, in cells of `spacing` px; see `Light`."""
    return Light(spacing).look(image, whole(image.shape))


@numba.njit(cache=True)
def peaks(response, shrink, least, separation, boxes):  # type: ignore[no-untyped-def]
    """Rows (N, 3) of x, y [px], value: maxima of a `response` above `least`.

    A maximum is the highest within ±`separation` cells. In boxes of cells of `shrink` px that
    don't overlap; what lies around them, up to the separation, is compared with.
    """
    height, width = response.shape
    found = []
    for y0, x0, y1, x1 in boxes:
        first, end = max(x0 - 1, 0), min(x1 + 1, width)
        crest = np.empty(end - first, np.uint8)
        for y in range(max(y0, 1), min(y1, height - 1)):
            _crests(response[y - 1, first:end], response[y, first:end],
                    response[y + 1, first:end], least, crest)
            for k in range(1, len(crest) - 1):
                if crest[k] and _highest(response, first + k, y, separation):
                    found.append(_top(response, first + k, y))
    rows = np.empty((len(found), 3))
    for k in range(len(found)):
        x, y, value = found[k]
        rows[k, 0], rows[k, 1] = (x + 0.5) * shrink - 0.5, (y + 0.5) * shrink - 0.5
        rows[k, 2] = value
    return rows


@numba.njit(cache=True)
def _top(response, x, y):  # type: ignore[no-untyped-def]
    """The place of a maximum between the cells, by a parabola, and its value."""
    value = response[y, x]
    bend_x = response[y, x + 1] - 2 * value + response[y, x - 1]
    bend_y = response[y + 1, x] - 2 * value + response[y - 1, x]
    ox = (response[y, x - 1] - response[y, x + 1]) / 2 / min(bend_x, -1e-9)
    oy = (response[y - 1, x] - response[y + 1, x]) / 2 / min(bend_y, -1e-9)
    return x + min(max(ox, -0.5), 0.5), y + min(max(oy, -0.5), 0.5), value


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


@numba.njit(cache=True)
def pixel_noise(image):  # type: ignore[no-untyped-def]
    """Standard deviation of the pixel noise [grey], from a twofold second difference.

    What varies slower than from pixel to pixel drops out (J. Immerkær, Computer Vision and Image
    Understanding 64, 300, 1996); the median makes edges of particles drop out too.
    """
    rows, columns = max(1, image.shape[0] // 40), max(1, image.shape[1] // 40)
    middle = np.median(_second_differences(image, rows, columns))
    return max(1.4826 * middle / 6, _LEAST_NOISE)


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
