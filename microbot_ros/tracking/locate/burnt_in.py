"""Text that a camera or recorder wrote into the pictures: it has no sensor noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ros.tracking.locate.bodies import Bodies, find_bodies
from microbot_ros.tracking.locate.kinds import Kind
from microbot_ros.tracking.locate.standing import Place

LEAST_FRAMES = 8
"""Choice: pictures needed to see whether a place has noise."""

_QUIET = 0.3
"""Choice: noise over that of the whole picture below which a place has none of its own."""

_MOSTLY = 75
"""Choice: percentage of quiet pixels of a body; its rim may be half transparent."""

_LEAST_NOISE = 0.4
"""Choice: grey levels of noise below which resting objects look quiet too (codecs)."""

_SAMPLES = 64
"""Choice: points across the shorter side at which the noise is sampled."""


def burnt_in(frames: Sequence[np.ndarray], kinds: Sequence[Kind]) -> tuple[Place, ...]:
    """Return places in `frames` (H, W), a moment apart, where burnt-in text looks like a kind.

    `kinds` are those searched. A resting robot stands as still, but has the sensor's noise, which
    differs between pictures. Empty for too few pictures or too little noise.

    Parameters
    ----------
    frames : sequence of ndarray
        Pictures (H, W).
    kinds : sequence of Kind
        The kinds.

    Returns
    -------
    tuple of Place
        The places.
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
    """Return all bodies that may be taken for a `kind` known to be there."""
    bodies = find_bodies(image, kind.dark, 0.6 * kind.height_grey[0], kind.shrink,
                         kind.width_px[1], kind.parts_px)
    return bodies[kind.members(bodies, np.ones(len(bodies), bool))]


def _noise(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Return the noise of each pixel (H, W) from differences of `frames`, free of light drift."""
    steps = np.diff(np.array(frames, np.float32), axis=0)
    return np.asarray(np.sqrt(np.mean(steps**2, axis=0) / 2))


def _own_noise(frames: Sequence[np.ndarray], bodies: Bodies, n: int, dark: bool) -> float:
    """Return the noise [grey] that most pixels within the outline of body `n` do not exceed."""
    (left, top), (right, bottom) = bodies.lower[n].astype(int), bodies.upper[n].astype(int) + 1
    boxes = [frame[top:bottom, left:right] for frame in frames]
    last = boxes[-1].astype(float)
    extreme = last.min() if dark else last.max()
    inside = np.abs(last - extreme) < bodies.height[n] / 2
    return float(np.percentile(_noise(boxes)[inside], _MOSTLY))
