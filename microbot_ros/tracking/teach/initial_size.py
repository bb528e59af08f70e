"""First estimate of size and positions of particles: blobs that explain the picture best."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from microbot_ros.tracking.locate.search import block_mean, peaks, spread
from microbot_ros.tracking.settings import TrackerSettings

LEAST_DIAMETER = 2.5
"""Choice: smallest diameter [px]; anything smaller, such as a hot pixel, is not resolved."""

_LADDER = 2.0 ** np.arange(2, 6.6, 0.5)
"""Choice: diameters [px] tried: 4 to 76."""

_NEARLY_ALL = 0.9
"""Choice: the smallest width that explains this share of the maximum is taken."""

_MOST_CANDIDATES = 80  # choice: spots per frame; more cost time and tell nothing new
_MOST_PIXELS = 150_000  # choice: pixels of all spots, which bounds the time
_LEAST_SIGMA = 8.0  # choice: least response, in σ of its noise


@dataclass(frozen=True)
class InitialSize:
    """Spots of one `diameter` [px] and `sign` (−1 dark, 1 bright): rows x, y, response per frame.

    `energy` is the energy of the frames that their mean picture explains.
    """

    diameter: float
    sign: float
    spots: list[np.ndarray]
    energy: float = 0.0


def best_initial_size(
    frames: list[np.ndarray], settings: TrackerSettings
) -> Generator[None, None, InitialSize | None]:
    """Find the width and sign whose spots explain most of `frames` (H, W); None if none does.

    A generator that yields between portions of the work and returns the result; `settings` may fix
    the diameter or the sign.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    settings : TrackerSettings
        Settings of the tracker.

    Returns
    -------
    Generator[None, None, InitialSize or None]
        The size, or None.
    """
    signs = {'dark': [-1.0], 'bright': [1.0], None: [-1.0, 1.0]}[settings.contrast]
    ladder = _LADDER if settings.diameter_px is None else [settings.diameter_px]
    candidates: list[InitialSize] = []
    for diameter in ladder:
        if 2 * diameter >= min(frames[0].shape):
            break
        for sign in signs:
            initial = _initial_size(frames[:2], float(diameter), sign)
            yield
            if initial is not None:
                candidates.append(initial)
    # A window wider than the particle explains it too, and a little of its surroundings.
    most = max((initial.energy for initial in candidates), default=0.0)
    best = next((initial for initial in candidates if initial.energy > _NEARLY_ALL * most), None)
    return None if best is None else initial_size_at(frames, best.diameter, best.sign)


def initial_size_at(frames: list[np.ndarray], diameter: float, sign: float) -> InitialSize | None:
    """Return the strongest spots of one `diameter` [px] and `sign` in `frames`; None if none.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    diameter : float
        Diameter [px].
    sign : float
        −1 for dark, 1 for bright.

    Returns
    -------
    InitialSize or None
        The spots, or None.
    """
    # Enough pixels for a smooth picture; the strongest spots are most likely particles.
    most = max(4, int(_MOST_PIXELS / len(frames) / (1.5 * diameter + 3) ** 2 / 4))
    everywhere = [_spots(frame, diameter, sign)[:most] for frame in frames]
    if not any(map(len, everywhere)):
        return None
    return InitialSize(diameter, sign, everywhere)


def outer_diameter(frames: list[np.ndarray], initial: InitialSize) -> float:
    """Return the width [px] at which the typical spot of `frames` has half contrast, from outside.

    Typical is the median over the `initial` spots of their grey values at each distance, weighted
    by energy, so that rings, neighbours and many small specks do not mislead it. The diameter of
    `initial` is returned if no spot lies wholly in view.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    initial : InitialSize
        The initial size.

    Returns
    -------
    float
        Diameter [px].
    """
    profiles = []
    for frame, spots in zip(frames, initial.spots, strict=True):
        radius, grey = _patches(frame, spots, 1.25 * initial.diameter + 2)
        for r, values in zip(np.rint(radius).astype(int), grey, strict=True):
            profiles.append(np.bincount(r, values) / np.bincount(r))
    if not profiles:
        return initial.diameter
    contrast = np.array(profiles)
    contrast -= np.median(contrast[:, -max(2, contrast.shape[1] // 6):], axis=1, keepdims=True)
    energy = contrast**2 @ np.arange(contrast.shape[1])
    share = np.abs(_weighted_median(contrast, energy))
    half = np.max(share) / 2
    within = np.flatnonzero(share[:-1] > half)
    if len(within) == 0:
        return initial.diameter
    last = within[-1]
    return float(2 * (last + (share[last] - half) / (share[last] - share[last + 1])))


def _weighted_median(rows: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the median (K,) of rows (N, K) weighted by `weight` (N,)."""
    order = np.argsort(rows, axis=0)
    below = np.cumsum(weight[order], axis=0)
    middle = np.argmax(below >= 0.5 * below[-1], axis=0)
    return rows[order[middle, np.arange(rows.shape[1])], np.arange(rows.shape[1])]


def _spots(frame: np.ndarray, diameter: float, sign: float) -> np.ndarray:
    """Return rows (N, 3) x, y, response of the strongest blobs of one width and sign."""
    import cv2

    shrink = max(1, int(diameter / 8))
    image = block_mean(frame, shrink) * np.float32(sign)
    inner = 0.3 * diameter / shrink
    outer = 1.6 * inner
    response = cv2.GaussianBlur(image, (0, 0), inner) - cv2.GaussianBlur(image, (0, 0), outer)
    noise = max(spread(response), 0.3 * 0.2 / inner)
    found: np.ndarray = peaks(response, shrink, _LEAST_SIGMA * noise,
                              max(1, int(0.5 * diameter / shrink)))
    return found[np.argsort(-found[:, 2])][:_MOST_CANDIDATES]


def _initial_size(frames: list[np.ndarray], diameter: float, sign: float) -> InitialSize | None:
    reach = 1.25 * diameter + 2
    spots = [_spots(frame, diameter, sign) for frame in frames]
    patches = [_patches(f, s, reach) for f, s in zip(frames, spots, strict=True)]
    radius, grey = (np.concatenate(part) for part in zip(*patches, strict=True))
    if len(radius) == 0:
        return None
    grey = grey - np.mean(grey, axis=1, keepdims=True)
    ring = np.minimum(radius.astype(int), int(reach))
    count = np.maximum(np.bincount(ring.ravel()), 1)
    profile = np.bincount(ring.ravel(), grey.ravel()) / count
    picture = profile[ring] - np.mean(profile[ring], axis=1, keepdims=True)
    overlap = np.sum(picture * grey, axis=1)
    explained = np.maximum(overlap, 0) ** 2 / np.sum(picture**2, axis=1)
    return InitialSize(diameter, sign, spots, float(np.sum(explained)))


def _patches(
    frame: np.ndarray, spots: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return distance from the centre and grey value, (N, P) each, of discs inside the picture."""
    span = int(reach)
    v, u = np.mgrid[-span:span + 1, -span:span + 1]
    disc = u**2 + v**2 <= reach**2
    u, v = u[disc], v[disc]
    centre = np.rint(spots[:, :2]).astype(int)
    limit = np.array(frame.shape[::-1]) - span
    centre = centre[np.all((centre >= span) & (centre < limit), axis=1)]
    x, y = centre[:, :1] + u, centre[:, 1:] + v
    return np.broadcast_to(np.hypot(u, v), x.shape), frame[y, x].astype(float)
