"""What stands still in the picture: text, bars, dirt on the optics."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from microbot_ros.files import Settings
from microbot_ros.tracking.bodies import Bodies

_SAME = 3.0
"""Pixels: how near to itself what stands still is found again."""

_STILL = 1.0
"""Pixels: the most by which the place of what stands still is spread."""

_WANDERS = 1.0
"""Least mean square of the steps over the variance of the places (J. von Neumann, Annals of
Mathematical Statistics 12, 367, 1941): 2 for errors about one place, 0.5 for a random walk."""

_MOSTLY = 0.75
"""Share of the frames in which it is found."""


class Place(Settings):
    """A disc of the picture in which nothing is a particle."""

    x_px: float = Field(description='its middle [px]')
    y_px: float = Field(description='its middle [px]')
    radius_px: float = Field(gt=0, le=10_000, description='its radius [px]')


def standing(seen: list[Bodies]) -> list[Place]:
    """Where something stands still in pictures from all over a film, of which `seen` are bodies.

    A thing that drifts with the sample doesn't: the spread of its places shows it.
    """
    places: list[Place] = []
    # What is hidden at the beginning may show in the middle.
    for first in (seen[0], seen[len(seen) // 2]):
        for xy, width in zip(first.xy, first.width, strict=True):
            known = any(np.hypot(place.x_px - xy[0], place.y_px - xy[1]) < _SAME
                        for place in places)
            middle = None if known else _still(seen, xy)
            if middle is not None:
                places.append(Place(
                    x_px=round(float(middle[0]), 1), y_px=round(float(middle[1]), 1),
                    radius_px=round(float(max(3.0, width / 2)), 1)))
    return places


def _still(seen: list[Bodies], xy: np.ndarray) -> np.ndarray | None:
    """The middle (2,) of the places of what is near `xy` in most pictures; None if it moves."""
    away = [np.linalg.norm(bodies.xy - xy, axis=1) for bodies in seen]
    near = [bodies.xy[np.argmin(off)] for bodies, off in zip(seen, away, strict=True)
            if len(off) and off.min() < _SAME]
    if len(near) < max(_MOSTLY * len(seen), 3) or np.max(np.std(near, axis=0)) > _STILL:
        return None
    variance = np.sum(np.var(near, axis=0))
    if np.mean(np.sum(np.diff(near, axis=0) ** 2, axis=1)) < _WANDERS * variance:
        return None
    return np.asarray(np.median(near, axis=0))
