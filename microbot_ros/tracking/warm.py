"""Compilation of the tracker before the first frame, which would otherwise wait for it."""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np

from microbot_ros.tracking.link.assign import assign
from microbot_ros.tracking.settings import TrackerSettings
from microbot_ros.tracking.teach.learn import learn
from microbot_ros.tracking.teach.teacher import like
from microbot_ros.tracking.tracker import Tracker


@cache
def warm_up(dtype: type[np.uint8] | type[np.uint16] = np.uint8) -> None:
    """Run every path of the tracker once on small pictures of this `dtype`.

    Compiled code is cached on disk, so that this takes some ten seconds once and a fraction of a
    second afterwards. Call it before frames arrive.

    Parameters
    ----------
    dtype : type[uint8] or type[uint16]
        Type of the pixels.
    """
    # Needed when two particles compete for a detection; loading them would delay that frame.
    import scipy.optimize
    import scipy.sparse.csgraph  # noqa: F401

    at, one = np.zeros((2, 2)), np.ones(2)
    assign(at, one, one, at, one, at, one, at, 1.0, 1e-9)  # two that compete
    rng = np.random.default_rng(0)
    shapes: tuple[tuple[Literal['round', 'any'], float], ...] = (
        ('round', 0.0), ('round', 40.0), ('any', 0.0))
    for shape, cap in shapes:
        settings = TrackerSettings(shape=shape, diameter_px=10)
        scale = 1 if dtype is np.uint8 else 64
        # One frame more than needed to name a particle.
        frames = [
            (_discs(rng, cap) * scale).astype(dtype) for _ in range(settings.confirm_frames + 1)]
        tracker = Tracker(settings, learn(frames, settings))
        for k, frame in enumerate(frames):
            tracker.update(frame, float(k))
    # A kind may be taught while frames arrive.
    taught, _ = like(TrackerSettings(), frames[0], 45.0, 80.0)
    tracker.teach(taught)
    for k, frame in enumerate(frames):
        tracker.update(frame, float(len(frames) + k))


def _discs(rng: np.random.Generator, cap: float) -> np.ndarray:
    """Return a picture of discs, one side of each darker by `cap`: enough to detect shaking."""
    y, x = np.mgrid[0:160, 0:320]
    picture = 150 + rng.normal(0, 1, x.shape)
    for k, angle in enumerate((0.4, 2.1, -1.2, 3.0, -2.5)):
        u, v = x - 45 - 57 * k, y - 80
        inside = 1 / (1 + np.exp(2 * (np.hypot(u, v) - 5)))
        side = 1 / (1 + np.exp(-2 * (u * np.cos(angle) + v * np.sin(angle))))
        picture -= inside * (60 + cap * side)
    return picture
