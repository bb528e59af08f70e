"""Bodies of any size and shape, with the outline at half their height above the illumination.

No size is needed. A body is a maximum of the contrast with all that is connected to it at more
than half its height. A maximum connected to a higher one above half of its own height is a part of
that one's body, or of none.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.locate.search import block_mean, pixel_noise
from microbot_ros.tracking.refine.fit import FAST

_HALF = 0.5
"""Choice: share of a body's height at which its outline runs."""

_NECK = 0.85
"""Choice: share of the lower body's height up to which a neck parts two known bodies."""

_LEAST_AREA = 6
"""Choice: shrunk pixels; anything smaller has no shape."""

_LIGHT = 3.0
"""Choice: widths of the largest body across the neighbourhood whose median is the light."""

_SMOOTH = 0.8
"""Choice: blur [shrunk px] that suppresses maxima of noise."""


@dataclass(frozen=True)
class Bodies:
    """Bodies of one picture, arrays of equal length N.

    Attributes
    ----------
    xy : (N, 2) array [px]
        Centroid of the contrast above that of the outline.
    height : (N,) array [grey]
        Largest contrast.
    width : (N,) array [px]
        Diameter of a disc of equal area.
    edge : (N,) array [px]
        Width of the edge: half the height over its slope at the outline, small in focus.
    length, fill : (N,) array
        Length over width of the ellipse with equal second moments, and area over that of this
        ellipse: 1 for a disc or a rod, less for bent or branched bodies.
    halo : (N,) array
        Contrast of the opposite sign next to it, as a share of the height.
    angle : (N,) array [rad]
        Direction of its length, image sense, between 0 and π.
    cut : (N,) bool array
        Whether it touches the edge of the picture.
    lower, upper : (N, 2) array [px]
        Corners of its bounding box.
    weight, spread : (N,) array [shrunk px]
        Sum of the contrast above the outline's over the largest, and sum of squared distances from
        the centroid; they give the error of the centroid.
    """

    xy: np.ndarray
    height: np.ndarray
    width: np.ndarray
    edge: np.ndarray
    length: np.ndarray
    fill: np.ndarray
    halo: np.ndarray
    angle: np.ndarray
    cut: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    weight: np.ndarray
    spread: np.ndarray

    def __len__(self) -> int:
        return len(self.xy)

    def __getitem__(self, rows: np.ndarray) -> Bodies:
        return Bodies(*(getattr(self, part.name)[rows] for part in fields(self)))


def contrast(image: np.ndarray, shrink: int, widest_px: float, dark: bool) -> np.ndarray:
    """Return how an `image` (H, W) differs from its illumination, float32, shrunk by `shrink`.

    Positive where darker if `dark`, else where brighter. The illumination is the median over a
    neighbourhood in which a body of `widest_px` is the smaller part.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The picture.
    shrink : int
        Factor by which the picture is shrunk.
    widest_px : float
        Largest width of a body [px].
    dark : bool
        Whether bodies are darker than the illumination.

    Returns
    -------
    ndarray
        Contrast, float32 [grey].
    """
    import cv2

    small = block_mean(image, shrink)
    coarse = max(1, min(int(widest_px * _LIGHT / shrink / 16), *small.shape))
    cells = block_mean(small, coarse)
    # OpenCV's large medians need bytes, which resolve the illumination well enough.
    low, high = float(cells.min()), max(float(cells.max()), float(cells.min()) + 1.0)
    scale = 255.0 / (high - low)
    across = int(widest_px * _LIGHT / shrink / coarse) // 2 * 2 + 1
    across = max(3, min(across, 2 * (min(cells.shape) // 2) - 1))
    light: np.ndarray = cv2.medianBlur(((cells - low) * scale).astype(np.uint8), across)
    smooth = cv2.blur(light.astype(np.float32), (max(3, across // 4 * 2 + 1),) * 2)
    smooth = np.asarray(smooth / scale + low, np.float32)
    light = cv2.resize(smooth, small.shape[::-1], interpolation=cv2.INTER_LINEAR)
    first, second = (light, small) if dark else (small, light)
    raised: np.ndarray = cv2.GaussianBlur(first - second, (0, 0), _SMOOTH)
    return raised


def find_bodies(
    image: np.ndarray, dark: bool, least_height: float, shrink: int, widest_px: float,
    nearest_px: float = 0.0, known: np.ndarray | None = None,
) -> Bodies:
    """Find the bodies of an image.

    Parameters
    ----------
    image : (H, W) array
        Grey values of the picture.
    dark : bool
        Whether bodies are darker than the illumination, else brighter.
    least_height : float [grey]
        Least contrast of a body.
    shrink : int
        Factor by which the picture is shrunk.
    widest_px : float
        Largest width; anything wider is illumination.
    nearest_px : float
        Maxima nearer than this belong to one body.
    known : (M, 2) array [px], optional
        Expected bodies. Several in one outline, each with a maximum of its own, are parted at the
        neck; one that touches a higher body is not part of that body.

    Returns
    -------
    Bodies
        The bodies.
    """
    import cv2

    picture = contrast(image, shrink, widest_px, dark)
    if nearest_px / shrink > 2:
        picture = cv2.GaussianBlur(picture, (0, 0), nearest_px / shrink / 2)
    least = max(least_height, 4 * pixel_noise(image) / shrink)
    places = np.empty((0, 2)) if known is None else (known + 0.5) / shrink - 0.5
    rows = _bodies(picture, least, int((widest_px / shrink) ** 2 * 1.5), places)
    return _described(rows, shrink, picture.shape)


(_X, _Y, _HEIGHT, _AREA, _WEIGHT, _XX, _YY, _XY, _SLOPE, _RIM, _X0, _Y0, _X1, _Y1, _SPREAD,
 _HALO) = range(16)


def _described(rows: np.ndarray, shrink: int, shape: tuple[int, ...]) -> Bodies:
    area, rim = rows[:, _AREA], np.maximum(rows[:, _RIM], 1)
    middle = (rows[:, _XX] + rows[:, _YY]) / 2 + 1 / 12
    root = np.hypot((rows[:, _XX] - rows[:, _YY]) / 2, rows[:, _XY])
    least = np.maximum(middle - root, 1 / 12)
    slope = np.maximum(rows[:, _SLOPE] / rim, 1e-6)
    edges = (rows[:, _X0] <= 0) | (rows[:, _Y0] <= 0)
    edges |= (rows[:, _X1] >= shape[1] - 1) | (rows[:, _Y1] >= shape[0] - 1)
    return Bodies(
        xy=(rows[:, [_X, _Y]] + 0.5) * shrink - 0.5,
        height=rows[:, _HEIGHT],
        width=np.sqrt(4 * area / np.pi) * shrink,
        edge=_HALF * rows[:, _HEIGHT] / slope * shrink,
        length=np.sqrt((middle + root) / least),
        fill=area / (4 * np.pi * np.sqrt((middle + root) * least)),
        halo=rows[:, _HALO] / rows[:, _HEIGHT],
        angle=np.mod(0.5 * np.arctan2(2 * rows[:, _XY], rows[:, _XX] - rows[:, _YY]), np.pi),
        cut=edges,
        lower=rows[:, [_X0, _Y0]] * shrink,
        upper=(rows[:, [_X1, _Y1]] + 1) * shrink - 1,
        weight=rows[:, _WEIGHT],
        spread=rows[:, _SPREAD],
    )


@numba.njit(cache=True, nogil=True)
def _bodies(picture, least, most, known):  # type: ignore[no-untyped-def]
    """Return rows of sums (N, 16), in order of the names above, for bodies up to `most` pixels.

    Those `known` (M, 2) that share an outline are separate bodies.
    """
    places = _maxima(picture, least)
    owner = np.zeros(picture.shape, np.int32)
    stack = np.empty((most + 8, 2), np.int32)
    rows = np.empty((len(places), 16))
    count = 0
    for k in range(len(places)):
        area = _flood(picture, owner, places[k], k + 1, stack, most, False)
        if area < 0 and len(known) > 0:
            for n in range(-area):
                owner[stack[n, 0], stack[n, 1]] = 0
            area = _flood(picture, owner, places[k], k + 1, stack, most, True)
            if len(_inside(owner, k + 1, known)) == 0:
                area = 0
        if area < _LEAST_AREA:
            continue
        level = _HALF * picture[places[k, 0], places[k, 1]]
        seeds = _seeds(owner, k + 1, places, known)
        parts = np.zeros(area, np.int64)
        if len(seeds) > 1:
            parts = _parted(owner, picture, k + 1, stack[:area], places[seeds])
        for part in range(parts.max() + 1):
            mine = stack[:area][parts == part]
            if len(mine) >= _LEAST_AREA:
                _sum(picture, mine, level, rows[count])
                rows[count, _HALO] = _halo(picture, rows[count])
                count += 1
    return rows[:count]


@numba.njit(cache=True, nogil=True)
def _seeds(owner, name, places, known):  # type: ignore[no-untyped-def]
    """Return which maxima of `places` (N, 2) in the body `name` are nearest to `known` ones.

    The highest comes first; only that of the body if fewer than two are known in it.
    """
    inside = _inside(owner, name, known)
    if len(inside) < 2:
        return np.array([name - 1])
    seeds = []
    for n in inside:
        best, nearest = -1, np.inf
        for k in range(len(places)):
            away = (places[k, 1] - known[n, 0]) ** 2 + (places[k, 0] - known[n, 1]) ** 2
            if away < nearest and owner[places[k, 0], places[k, 1]] == name:
                best, nearest = k, away
        if best not in seeds:
            seeds.append(best)
    return np.sort(np.array(seeds))


@numba.njit(cache=True, nogil=True)
def _inside(owner, name, known):  # type: ignore[no-untyped-def]
    """Return which of `known` (M, 2) are in the body `name`."""
    inside = np.zeros(len(known), np.bool_)
    for n in range(len(known)):
        x, y = round(known[n, 0]), round(known[n, 1])
        if 0 <= y < owner.shape[0] and 0 <= x < owner.shape[1]:
            inside[n] = owner[y, x] == name
    return np.flatnonzero(inside)


@numba.njit(cache=True, nogil=True)
def _parted(owner, picture, name, pixels, seeds):  # type: ignore[no-untyped-def]
    """Return the part (n,), from 0, of each of the `pixels` (n, 2) of the body `name`.

    Each of the `seeds` (K, 2), the highest first, starts a part with all above its neck; other
    pixels join the part that reaches them first. Meanwhile `owner` holds −1 − part.
    """
    queue, count, parts = np.empty(pixels.shape, np.int64), 0, 0
    for k in range(len(seeds)):
        more = _core(picture, owner, name, -1 - parts, seeds[k], queue, count)
        parts += more > count
        count = more
    done = 0
    while done < count:
        y, x = queue[done]
        done += 1
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            b, a = y + dy, x + dx
            if 0 <= b < owner.shape[0] and 0 <= a < owner.shape[1] and owner[b, a] == name:
                owner[b, a] = owner[y, x]
                queue[count, 0], queue[count, 1] = b, a
                count += 1
    part = np.empty(len(pixels), np.int64)
    for n in range(len(pixels)):
        part[n] = -1 - owner[pixels[n, 0], pixels[n, 1]]
        owner[pixels[n, 0], pixels[n, 1]] = name
    return part


@numba.njit(cache=True, nogil=True)
def _core(picture, owner, name, label, seed, queue, start):  # type: ignore[no-untyped-def]
    """Add all above the neck of a `seed` to a `queue` of `start` rows; return its new length.

    The length is unchanged if the seed is part of another: there is no neck between them.
    """
    level = _NECK * picture[seed[0], seed[1]]
    if owner[seed[0], seed[1]] != name:
        return start
    queue[start], count, done = seed, start + 1, start
    owner[seed[0], seed[1]] = label
    while done < count:
        y, x = queue[done]
        done += 1
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            b, a = y + dy, x + dx
            if not (0 <= b < owner.shape[0] and 0 <= a < owner.shape[1]):
                continue
            if picture[b, a] <= level or owner[b, a] == label:
                continue
            if owner[b, a] != name:
                for n in range(start, count):
                    owner[queue[n, 0], queue[n, 1]] = name
                return start
            owner[b, a] = label
            queue[count, 0], queue[count, 1] = b, a
            count += 1
    return count


@numba.njit(cache=True, fastmath=FAST)
def _maxima(picture, least):  # type: ignore[no-untyped-def]
    """Return rows and columns (N, 2) of the local maxima above `least`, the highest first."""
    height, width = picture.shape
    found = [(0, 0)]
    values = [np.float32(0.0)]
    for y in range(height):
        for x in range(width):
            value = picture[y, x]
            if value <= least:
                continue
            top = True
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    v, u = y + dy, x + dx
                    if 0 <= v < height and 0 <= u < width and picture[v, u] > value:
                        top = False
            if top:
                found.append((y, x))
                values.append(value)
    order = np.argsort(-np.array(values)[1:])
    places = np.empty((len(order), 2), np.int64)
    for k in range(len(order)):
        places[k, 0], places[k, 1] = found[order[k] + 1]
    return places


@numba.njit(cache=True)
def _flood(picture, owner, place, name, stack, most, walled):  # type: ignore[no-untyped-def]
    """Fill `stack` with the pixels connected to a maximum above half its height; return the count.

    0 if it reaches a higher pixel or more than `most`. Pixels of another body are skipped if
    `walled`; otherwise minus the number of pixels is returned as soon as one is reached.
    """
    y, x = place
    if owner[y, x] > 0:
        return 0
    height, width = picture.shape
    top, level = picture[y, x], _HALF * picture[y, x]
    stack[0, 0], stack[0, 1] = y, x
    owner[y, x] = name
    count, done = 1, 0
    while done < count:
        v, u = stack[done, 0], stack[done, 1]
        done += 1
        for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            b, a = v + dv, u + du
            if not (0 <= b < height and 0 <= a < width) or owner[b, a] == name:
                continue
            value = picture[b, a]
            if value <= level:
                continue
            if owner[b, a] > 0:
                if walled:
                    continue
                return -count
            if value > top or count >= most:
                return 0
            owner[b, a] = name
            stack[count, 0], stack[count, 1] = b, a
            count += 1
    return count


@numba.njit(cache=True)
def _sum(picture, stack, level, row):  # type: ignore[no-untyped-def]
    """Write sums over the pixels `stack` (n, 2) of one body above a `level`; see the names above.

    Pixels are weighted by their excess, so that pixels that noise adds or removes have no effect.
    """
    height, width = picture.shape
    count, top = len(stack), np.float32(0.0)
    for k in range(count):
        top = max(top, picture[stack[k, 0], stack[k, 1]])
    row[:] = 0
    row[_HEIGHT], row[_AREA] = top, count
    row[_X0], row[_Y0], row[_X1], row[_Y1] = width, height, -1, -1
    for k in range(count):
        y, x = stack[k, 0], stack[k, 1]
        w = (picture[y, x] - level) / top
        row[_WEIGHT] += w
        row[_X] += w * x
        row[_Y] += w * y
        row[_X0], row[_X1] = min(row[_X0], x), max(row[_X1], x)
        row[_Y0], row[_Y1] = min(row[_Y0], y), max(row[_Y1], y)
        inside = 0 < y < height - 1 and 0 < x < width - 1
        if inside and min(picture[y - 1, x], picture[y + 1, x], picture[y, x - 1],
                          picture[y, x + 1]) <= level:
            right = (picture[y, x + 1] - picture[y, x - 1]) / 2
            down = (picture[y + 1, x] - picture[y - 1, x]) / 2
            row[_SLOPE] += np.sqrt(right * right + down * down)
            row[_RIM] += 1
    row[_X] /= row[_WEIGHT]
    row[_Y] /= row[_WEIGHT]
    mx, my = 0.0, 0.0
    for k in range(count):
        mx += stack[k, 1]
        my += stack[k, 0]
    mx, my = mx / count, my / count
    for k in range(count):
        y, x = stack[k, 0], stack[k, 1]
        row[_XX] += (x - mx) ** 2 / count
        row[_YY] += (y - my) ** 2 / count
        row[_XY] += (x - mx) * (y - my) / count
        row[_SPREAD] += (x - row[_X]) ** 2 + (y - row[_Y]) ** 2


@numba.njit(cache=True)
def _halo(picture, row):  # type: ignore[no-untyped-def]
    """Return the largest contrast of opposite sign within a few pixels of a body."""
    height, width = picture.shape
    margin = 2 + int(0.25 * np.sqrt(row[_AREA]))
    deepest = np.float32(0.0)
    for y in range(max(int(row[_Y0]) - margin, 0), min(int(row[_Y1]) + margin + 1, height)):
        for x in range(max(int(row[_X0]) - margin, 0), min(int(row[_X1]) + margin + 1, width)):
            deepest = min(deepest, picture[y, x])
    return -deepest
