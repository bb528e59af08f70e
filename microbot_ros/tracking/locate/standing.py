"""Objects that stand still in the picture: text, bars, dirt on the optics."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.checked import Field, Settings
from microbot_ros.tracking.locate.bodies import Bodies

_SAME = 3.0
"""Choice: pixels within which a still object is found again."""

_STILL = 0.55
"""Largest spread [px] per coordinate of the position of a still object, a few outliers aside.

Measured on laboratory films: dirt and text 0.05 to 0.51, the slowest particles, which hardly
diffuse, 0.8 to 1.1.
"""

_OF_NORMAL = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""

_WANDERS = 1.0
"""Choice: least mean square step over the variance of the positions of a still object.

J. von Neumann, Annals of Mathematical Statistics 12, 367 (1941): 2 for independent errors, 0.5 for
a random walk.
"""

_STRAIGHT = 1.8
"""Choice: the same about a line: 2.4 for errors, 1.25 for a random walk of a dozen steps."""

_MOSTLY = 0.75
"""Choice: share of the frames in which it is found."""


class Place(Settings):
    """A disc of the picture in which nothing is a particle."""

    x_px: float = Field(description='its middle [px]')
    y_px: float = Field(description='its middle [px]')
    radius_px: float = Field(gt=0, le=10_000, description='its radius [px]')

    def holds(self, x: float, y: float) -> bool:
        """Return whether the point (`x`, `y`) [px] lies in it.

        Parameters
        ----------
        x : float
            Column [px].
        y : float
            Row [px].

        Returns
        -------
        bool
            Whether it does.
        """
        return math.hypot(self.x_px - x, self.y_px - y) < self.radius_px


def standing(seen: list[Bodies], carried: bool = False) -> list[Place]:
    """Return places where bodies `seen` in pictures from all over a film stand still.

    The spread of positions excludes objects that drift with the sample. If `carried`, these are
    included as long as they drift in a straight line and by less than their own width.

    Parameters
    ----------
    seen : list of Bodies
        Bodies of each picture.
    carried : bool
        Whether objects that drift with the sample count.

    Returns
    -------
    list of Place
        The places.
    """
    places: list[Place] = []
    # Objects hidden at the start may be visible in the middle.
    for first in (seen[0], seen[len(seen) // 2]):
        for xy, width in zip(first.xy, first.width, strict=True):
            known = any(np.hypot(place.x_px - xy[0], place.y_px - xy[1]) < _SAME
                        for place in places)
            still = None if known else _still(seen, xy, width if carried else 0.0)
            if still is not None:
                middle, drift = still
                places.append(Place(
                    x_px=round(float(middle[0]), 1), y_px=round(float(middle[1]), 1),
                    radius_px=round(float(max(3.0, width / 2) + drift / 2), 1)))
    return places


def creeping(seen: list[Bodies]) -> list[Place]:
    """Return places where something stays within its own width in pictures from all over a film.

    `seen` are the bodies of the pictures. Gaps between living cells behave like this: they move
    with the cells, randomly and little from picture to picture, while a body that moves by itself
    leaves.

    Parameters
    ----------
    seen : list of Bodies
        Bodies of each picture.

    Returns
    -------
    list of Place
        The places.
    """
    places: list[Place] = []
    for first in (seen[0], seen[len(seen) // 2]):
        for xy, width in zip(first.xy, first.width, strict=True):
            if any(np.hypot(place.x_px - xy[0], place.y_px - xy[1]) < _SAME for place in places):
                continue
            _, near = _found_again(seen, xy, True)
            if len(near) < max(_MOSTLY * len(seen), 3):
                continue
            middle = np.median(near, axis=0)
            strayed = float(np.linalg.norm(near - middle, axis=1).max())
            if strayed <= width:
                places.append(Place(x_px=round(float(middle[0]), 1),
                                    y_px=round(float(middle[1]), 1),
                                    radius_px=round(float(max(3.0, width / 2)) + strayed, 1)))
    return places


def _still(seen: list[Bodies], xy: np.ndarray, farthest: float) -> tuple[np.ndarray, float] | None:
    """Return the middle (2,) of the positions of the object near `xy`, and its drift.

    None if it is not there in most pictures, moves otherwise than in a line, or drifts by more
    than `farthest` [px].
    """
    frames, near = _found_again(seen, xy, farthest > 0)
    if len(near) < max(_MOSTLY * len(seen), 3):
        return None
    middle = np.asarray(np.median(near, axis=0))
    if _scatters(near - middle, _WANDERS):
        return (middle, 0.0)
    if farthest == 0:
        return None
    since = frames - frames.mean()
    slope = since @ near / (since @ since)
    drift = float(np.hypot(*slope)) * float(np.ptp(frames))
    off = near - np.outer(since, slope)
    if drift > farthest or not _scatters(off - np.median(off, axis=0), _STRAIGHT):
        return None
    return (middle, drift)


def _found_again(seen: list[Bodies], xy: np.ndarray, carried: bool
                 ) -> tuple[np.ndarray, np.ndarray]:
    """Return the pictures (n,) in which something is near `xy`, and its positions (n, 2).

    If `carried`, it is searched near its last position.
    """
    frames, near = [], []
    for frame, bodies in enumerate(seen):
        away = np.linalg.norm(bodies.xy - xy, axis=1)
        if len(away) and away.min() < _SAME:
            frames.append(frame)
            near.append(bodies.xy[np.argmin(away)])
            xy = near[-1] if carried else xy
    return np.array(frames), np.array(near)


def _scatters(off: np.ndarray, least: float) -> bool:
    """Return whether positions `off` (n, 2) [px] their middle scatter little and randomly.

    `least` is the mean square step over the variance.
    """
    spread = _OF_NORMAL * np.median(np.abs(off), axis=0)
    if np.sqrt(np.mean(spread**2)) > _STILL:
        return False
    steps = np.mean(np.sum(np.diff(off, axis=0) ** 2, axis=1))
    return bool(steps >= least * np.sum(np.var(off, axis=0)))
