"""Where to look: all over the picture now and then, around the known particles in between."""

from __future__ import annotations

import math

import numba
import numpy as np

from microbot_ros.tracking.states import UNNAMED, TrackStates

_WORTH = 0.5
"""Share of the picture from which on windows save nothing."""


class SearchWindows:
    """Decides for each frame whether windows around the predictions are enough.

    They are, for `interval` [s] after the last look at everything, while every particle has an
    identity, stands by itself, was seen in the last frame and is expected within this one. A
    window holds all detections that the linker might take for the particle, and all of the picture
    that bears on them: within `margin_px` of these, rounded up to whole cells of `grain_px`. So
    windows change neither identities nor positions; they only delay finding somebody new.
    `max_step_px` is the linker's.
    """

    def __init__(self, interval: float, max_step_px: float, margin_px: float, grain_px: int
                 ) -> None:
        self._interval = interval
        self._reach = max_step_px + margin_px
        self._grain = grain_px
        self._everywhere = -math.inf

    def windows(self, t: float, states: TrackStates, size: tuple[int, int]) -> np.ndarray | None:
        """Boxes (n, 4) to look at in a picture of `size` (height, width) at time `t` [s]; None for
        all.
        """
        since = t - self._everywhere
        steady = (states.id != UNNAMED) & (states.missed == 0) & (states.host < 0)
        steady &= np.all((states.xy >= 0) & (states.xy < size[::-1]), axis=1)
        if not 0 <= since < self._interval or len(states) == 0 or not np.all(steady):
            return None
        half = (self._reach + states.radius)[:, None]
        yx = states.xy[:, ::-1]
        corners = np.hstack([(yx - half) // self._grain, -(-(yx + half) // self._grain)])
        boxes = np.clip(corners * self._grain, 0, np.array(size * 2)).astype(np.int64)
        area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
        return None if np.sum(area) > _WORTH * size[0] * size[1] else _apart(boxes)

    def looked_everywhere(self, t: float) -> None:
        """Remember that the whole picture was searched at time `t` [s]."""
        self._everywhere = t


@numba.njit(cache=True)
def _apart(boxes):  # type: ignore[no-untyped-def]
    """Boxes that hold the given ones and don't overlap."""
    count, i = len(boxes), 0
    while i < count:
        one, met = boxes[i], False
        for k in range(i + 1, count):
            other = boxes[k]
            if (one[0] < other[2] and other[0] < one[2]
                    and one[1] < other[3] and other[1] < one[3]):
                one[:2] = np.minimum(one[:2], other[:2])
                one[2:] = np.maximum(one[2:], other[2:])
                count -= 1
                other[:] = boxes[count]
                met = True
                break
        # Grown, it may overlap one that it was held against before.
        i = 0 if met else i + 1
    return boxes[:count].copy()
