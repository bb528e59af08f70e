"""Where to look: all over the picture now and then, around the known particles in between."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.link.states import PLACE, UNNAMED, TrackStates

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
        if not 0 <= t - self._everywhere < self._interval or len(states) == 0:
            return None
        boxes, area = _around(states.id, states.missed, states.host, states.motion, states.radius,
                              self._reach, self._grain, size)
        return None if area > _WORTH * size[0] * size[1] else _apart(boxes)

    def looked_everywhere(self, t: float) -> None:
        """Remember that the whole picture was searched at time `t` [s]."""
        self._everywhere = t


@numba.njit(cache=True)
def _around(ids, missed, host, motion, radius, reach, grain, size):  # type: ignore[no-untyped-def]
    """A box (N, 4) of whole cells around each particle, and their area; that of an infinite one
    where they are not enough.
    """
    boxes, area = np.empty((len(ids), 4), np.int64), 0.0
    for n in range(len(ids)):
        y, x, half = motion[n, PLACE].imag, motion[n, PLACE].real, reach + radius[n]
        if (ids[n] == UNNAMED or missed[n] > 0 or host[n] >= 0
                or not (0 <= x < size[1] and 0 <= y < size[0])):
            return boxes, math.inf
        for axis, at in enumerate((y, x)):
            first = math.floor((at - half) / grain) * grain
            last = math.ceil((at + half) / grain) * grain
            boxes[n, axis] = min(max(first, 0), size[axis])
            boxes[n, axis + 2] = min(max(last, 0), size[axis])
        area += (boxes[n, 2] - boxes[n, 0]) * (boxes[n, 3] - boxes[n, 1])
    return boxes, area


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
