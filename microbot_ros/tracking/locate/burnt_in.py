"""What a camera or a recorder has written into the pictures: it has none of the sensor's noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ros.tracking.locate.bodies import Bodies, find_bodies
from microbot_ros.tracking.locate.kinds import Kind
from microbot_ros.tracking.locate.standing import Place

LEAST_FRAMES = 8
"""Pictures that it takes to see whether a place has noise."""

_QUIET = 0.3
"""Noise over that of the whole picture below which a place has none of its own."""

_MOSTLY = 75
"""Percentage of the pixels of a body that must be quiet: its rim may be half see-through."""

_LEAST_NOISE = 0.4
"""Grey levels: with less noise all over, resting things are as quiet (codecs make them so)."""

_SAMPLES = 64
"""Points across the shorter side at which the noise of the picture is read."""


def burnt_in(frames: Sequence[np.ndarray], kinds: Sequence[Kind]) -> tuple[Place, ...]:
    """Where in `frames` (H, W), a moment apart, something burnt in looks like one of the `kinds`.

    A robot at rest stands as still, but has the noise of the sensor, which differs from picture to
    picture; letters don't. None where there are too few pictures, or no noise to tell by.
    """
    if len(frames) < LEAST_FRAMES:
        return ()
    spacing = max(1, min(frames[0].shape) // _SAMPLES)
    usual = float(np.median(_noise([frame[::spacing, ::spacing] for frame in frames])))
    if usual < _LEAST_NOISE:
        return ()
    return tuple(
        Place(x_px=round(float(bodies.xy[n, 0]), 1), y_px=round(float(bodies.xy[n, 1]), 1),
              radius_px=round(float(max(3.0, bodies.width[n] / 2)), 1))
        for kind in kinds for bodies in [_alike(frames[-1], kind)] for n in range(len(bodies))
        if _own_noise(frames, bodies, n, kind.dark) < _QUIET * usual)


def _alike(image: np.ndarray, kind: Kind) -> Bodies:
    """All that may be taken for a `kind` that is known to be there."""
    bodies = find_bodies(image, kind.dark, 0.6 * kind.height_grey[0], kind.shrink,
                         kind.width_px[1], kind.parts_px)
    return bodies[kind.members(bodies, np.ones(len(bodies), bool))]


def _noise(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Of each pixel (H, W), by the differences of successive `frames`: drifts of light cancel."""
    steps = np.diff(np.array(frames, np.float32), axis=0)
    return np.asarray(np.sqrt(np.mean(steps**2, axis=0) / 2))


def _own_noise(frames: Sequence[np.ndarray], bodies: Bodies, n: int, dark: bool) -> float:
    """The noise [grey] that most of the pixels within the outline of body `n` don't exceed."""
    (left, top), (right, bottom) = bodies.lower[n].astype(int), bodies.upper[n].astype(int) + 1
    boxes = [frame[top:bottom, left:right] for frame in frames]
    last = boxes[-1].astype(float)
    extreme = last.min() if dark else last.max()
    inside = np.abs(last - extreme) < bodies.height[n] / 2
    return float(np.percentile(_noise(boxes)[inside], _MOSTLY))
