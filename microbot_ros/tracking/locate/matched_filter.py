"""Search with the learned picture, the optimal linear filter for white noise."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.locate.search import block_mean_into, peaks, pixel_noise
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.refine.fit import FAST

_AT_ONCE = 4
"""Choice: weights of a folded kernel applied in one pass, four for the vector unit."""

_ENOUGH = 0.97
"""Choice: share of the filter's energy in the separable parts."""

_STILL_SHOWN = 0.6
"""Choice: share of a particle's energy that a shrunk picture must keep."""

_LEAST_WIDTH = 2.4
"""Choice: coarse pixels across a particle, so that two side by side stay separate."""


def _shrunk(appearance: Appearance, shrink: int, off: float = 0.0) -> np.ndarray:
    """Return the round picture minus its mean (K, K) in blocks of `shrink` px, off centre."""
    blocks = 2 * int(np.ceil((appearance.reach_px + off) / shrink - 0.5)) + 1
    fine = np.arange(0.5, blocks * shrink) - blocks * shrink / 2 - off
    u, v = fine[None, :], fine[:, None]
    disc = np.hypot(u, v) <= appearance.reach_px + 0.5
    picture = appearance.draw_round(u, v)
    picture = np.where(disc, picture - np.mean(picture[disc]), 0.0)
    return picture.reshape(blocks, shrink, blocks, shrink).mean(axis=(1, 3))


def _farthest_shrink(appearance: Appearance) -> int:
    """Return the factor at which a particle keeps enough energy in the worst position."""
    energy = np.sum(_shrunk(appearance, 1) ** 2)
    shrink = 1
    while shrink + 1 <= appearance.diameter_px / _LEAST_WIDTH:
        kept = min(
            np.sum(_shrunk(appearance, shrink + 1, off) ** 2) * (shrink + 1) ** 2
            for off in (0.0, (shrink + 1) / 2))
        if kept < _STILL_SHOWN * energy:
            break
        shrink += 1
    return shrink


class MatchedFilter:
    """The learned picture as a filter.

    It sums to zero and is symmetric, so that uniform light and slopes give no response. It is
    applied as a few separable filters (its singular vectors) to a picture shrunk as far as that
    still shows the particle, wherever it lies between the coarse pixels. `appearance` is the
    learned picture.

    Parameters
    ----------
    appearance : Appearance
        The learned picture.
    """

    def __init__(self, appearance: Appearance) -> None:
        self.shrink = _farthest_shrink(appearance)
        template = _shrunk(appearance, self.shrink)
        left, weight, right = np.linalg.svd(template)
        rank = int(np.searchsorted(np.cumsum(weight**2) / np.sum(weight**2), _ENOUGH)) + 1
        sums = weight[:rank] * right[:rank].sum(axis=1)
        # Truncation must not make the filter respond to the light itself.
        most = np.argmax(np.abs(sums))
        left[:, most] -= sums @ left[:, :rank].sum(axis=0) / (sums[most] * len(left))
        kernel = (left[:, :rank] * weight[:rank]) @ right[:rank]
        # Response in grey levels of contrast: a particle of contrast a responds with a.
        scale = 1 / np.sum(kernel * template)
        self._columns = _folded((left[:, :rank] * weight[:rank] * scale).T)
        self._rows = _folded(right[:rank])
        self.gain = float(scale * np.sqrt(np.sum(kernel**2)))
        self._separation = max(1, round(0.35 * appearance.diameter_px / self.shrink))
        self._small = self._response = np.empty((0, 0), np.float32)
        self.noise = 0.0
        """Standard deviation of the pixel noise [grey]."""
        self.texture = 0.0
        """Area [px²] in which the response, of either sign, exceeds noise."""

    def candidates(
        self, image: np.ndarray, least_sigma: float, least_contrast: float,
    ) -> np.ndarray:
        """Return maxima of the response to an `image` (N, 3): x, y [px], contrast [grey].

        Maxima count from `least_sigma` standard deviations of the response and `least_contrast`
        [grey].

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        least_sigma : float
            Least response, in standard deviations of the response.
        least_contrast : float
            Least contrast [grey].

        Returns
        -------
        ndarray, shape (N, 3)
            Column [px], row [px] and contrast [grey].
        """
        shape = (image.shape[0] // self.shrink, image.shape[1] // self.shrink)
        # Buffers are reused: fresh memory for each frame costs as much as the filters.
        if self._response.shape != shape:
            margin = 2 * (self._rows.shape[1] - 1)
            self._response = np.zeros(shape, np.float32)
            self._small = np.zeros((shape[0] + margin, shape[1] + margin), np.float32)
        _respond(image, self.shrink, self._small, self._columns, self._rows, self._response)
        self.noise = pixel_noise(image)
        least = least_sigma * self.noise * self.gain / self.shrink
        self.texture = _share_beyond(self._response, least) * image.size
        found: np.ndarray = peaks(
            self._response, self.shrink, max(least, least_contrast), self._separation)
        return found


def _folded(kernels: np.ndarray) -> np.ndarray:
    """Return symmetric kernels (n, 2K + 1) by distance from their middle, whose weight is halved.

    (n, a multiple of `_AT_ONCE`) float32: each weight applies to the two cells at that distance.
    """
    half = kernels[:, kernels.shape[1] // 2:].copy()
    half[:, 0] /= 2
    return np.pad(half, ((0, 0), (0, -half.shape[1] % _AT_ONCE))).astype(np.float32)


@numba.njit(cache=True)
def _respond(image, shrink, small, columns, rows, response):  # type: ignore[no-untyped-def]
    """Fill the response and the shrunk picture.

    The response is the contrast [grey] of a particle centred in each cell.
    """
    margin = columns.shape[1] - 1
    block_mean_into(small, image, shrink, margin)
    _mirror_edges(small, margin)
    _convolve(response, small, columns, rows)


@numba.njit(cache=True)
def _share_beyond(response, limit):  # type: ignore[no-untyped-def]
    """Return the share of the response beyond ±`limit`, from one cell in sixteen."""
    beyond = count = 0
    for y in range(1, response.shape[0], 4):
        for x in range(1, response.shape[1], 4):
            beyond += abs(response[y, x]) > limit
            count += 1
    return beyond / max(count, 1)


@numba.njit(cache=True)
def _mirror_edges(picture, margin):  # type: ignore[no-untyped-def]
    """Fill the margin with the mirror image of the inside, about the outermost cells."""
    height, width = picture.shape
    for k in range(1, margin + 1):
        top, bottom = margin, height - 1 - margin
        picture[top - k] = picture[min(top + k, bottom)]
        picture[bottom + k] = picture[max(bottom - k, top)]
    for y in range(height):
        left, right = margin, width - 1 - margin
        for k in range(1, margin + 1):
            picture[y, left - k] = picture[y, min(left + k, right)]
            picture[y, right + k] = picture[y, max(right - k, left)]


@numba.njit(cache=True, fastmath=FAST)
def _convolve(response, padded, columns, rows):  # type: ignore[no-untyped-def]
    """Write the sum of separable filters, `columns` and `rows` folded (n, K), into `response`.

    `padded` has a margin of K − 1 cells around the response.
    """
    margin = columns.shape[1] - 1
    line = np.empty(padded.shape[1], np.float32)
    for y in range(response.shape[0]):
        response[y] = 0
        for n in range(len(columns)):
            line[:] = 0
            for k in range(0, margin + 1, _AT_ONCE):
                _add_rows(line, padded, numba.uintp(y + margin - k), numba.uintp(y + margin + k),
                          columns[n, k], columns[n, k + 1], columns[n, k + 2], columns[n, k + 3])
            for k in range(0, margin + 1, _AT_ONCE):
                _add_shifted(response[y], line, numba.uintp(margin - k), numba.uintp(margin + k),
                             rows[n, k], rows[n, k + 1], rows[n, k + 2], rows[n, k + 3])


@numba.njit(cache=True, fastmath=FAST)
def _add_rows(line, picture, up, down, a, b, c, d):  # type: ignore[no-untyped-def]
    """Add rows `up`, `up` − 1 … and `down`, `down` + 1 … by their weights."""
    one, two, three = numba.uintp(1), numba.uintp(2), numba.uintp(3)
    for i in range(numba.uintp(line.size)):
        line[i] += (a * (picture[up, i] + picture[down, i])
                    + b * (picture[up - one, i] + picture[down + one, i])
                    + c * (picture[up - two, i] + picture[down + two, i])
                    + d * (picture[up - three, i] + picture[down + three, i]))


@numba.njit(cache=True, fastmath=FAST)
def _add_shifted(out, line, left, right, a, b, c, d):  # type: ignore[no-untyped-def]
    """Add the line from `left`, `left` − 1 … and `right`, `right` + 1 … by their weights."""
    one, two, three = numba.uintp(1), numba.uintp(2), numba.uintp(3)
    for i in range(numba.uintp(out.size)):
        out[i] += (a * (line[left + i] + line[right + i])
                           + b * (line[left - one + i] + line[right + one + i])
                           + c * (line[left - two + i] + line[right + two + i])
                           + d * (line[left - three + i] + line[right + three + i]))
