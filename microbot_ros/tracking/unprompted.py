"""Choosing what to follow without being told: what moves, is compact and in focus."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.tracking.bodies import Bodies, find_bodies
from microbot_ros.tracking.kinds_detector import KindsDetector
from microbot_ros.tracking.search import pixel_noise
from microbot_ros.tracking.settings import TrackerSettings
from microbot_ros.tracking.standing import standing
from microbot_ros.tracking.teach import like

_SHRINK, _WIDEST = 2, 120.0
"""How the pictures are first looked at: pixels taken as one, and the widest body [px]."""

_CLEAR = 8.0
"""Standard deviations of the noise that a body must stand out by."""

_LONGEST, _LEAST_FILL = 5.0, 0.55
"""Length over width, and share of the ellipse around it, of what is compact."""

_BLURRED = 0.55
"""Width of the edge over that of the body from which on it is out of focus."""

_EXAMPLES = (0.5, 0.25, 0.75)
"""Where in the order of contrast the examples are taken from what moves."""

_AS_DARK = 0.5
"""Least contrast of an example over that of the first."""

_AGREED = 0.7
"""Share of what moves that the usual way must find, to be kept, where it is more exact."""

Finder = Callable[[np.ndarray], np.ndarray]
"""Places (N, 2) [px] of the particles in a picture (H, W)."""


def choose(frames: list[np.ndarray], settings: TrackerSettings) -> TrackerSettings | None:
    """The `settings` with a kind for what moves in `frames` (H, W) from all over a film.

    None where nothing moves that is compact and in focus.
    """
    # What is there in the middle of the film may be hidden at its beginning, and the reverse.
    by_sign = {dark: [_compact(frame, dark) for frame in frames] for dark in (True, False)}
    still = {dark: _standing(seen) for dark, seen in by_sign.items()}
    moving = {dark: [bodies[~_at(bodies, still[dark])] for bodies in seen]
              for dark, seen in by_sign.items()}
    dark = max(moving, key=lambda sign: _energy(moving[sign]))
    order = [(k, n) for k, bodies in enumerate(moving[dark]) for n in range(len(bodies))]
    if not order:
        return None
    weight = np.array([moving[dark][k].height[n] * moving[dark][k].width[n] for k, n in order])
    height = np.array([moving[dark][k].height[n] for k, n in order])
    return _pointed(frames, moving[dark], order, weight, height, settings)


def _pointed(
    frames: list[np.ndarray], moving: list[Bodies], order: list[tuple[int, int]],
    weight: np.ndarray, height: np.ndarray, settings: TrackerSettings,
) -> TrackerSettings | None:
    """Point at what is typical of what moves, as somebody would."""
    ranked = np.argsort(height)
    share = np.cumsum(weight[ranked]) / np.sum(weight)
    chosen, first = settings, 0.0
    for quantile in _EXAMPLES:
        k, n = order[ranked[np.searchsorted(share, quantile)]]
        first = first or float(moving[k].height[n])
        if moving[k].height[n] < _AS_DARK * first:
            continue
        try:
            x, y = moving[k].xy[n].tolist()
            chosen, _ = like(chosen, frames[k], x, y, 'particle')
        except InputError:
            continue
    if not chosen.kinds:
        return None
    return without_standing(chosen, frames, np.empty((0, 2)), carried=True)


def without_standing(
    settings: TrackerSettings, frames: list[np.ndarray], meant: np.ndarray, carried: bool = False
) -> TrackerSettings:
    """The `settings`, with the places where things stand still that look like their kinds.

    `frames` are from all over a film. Not among the places is what is `meant` (M, 2) [px]: who
    points at something that rests wants it followed. `carried`: what only drifts with the sample
    stands, too.
    """
    places = []
    for kind in settings.kinds:
        seen = []
        for frame in frames:
            bodies = find_bodies(frame, kind.dark, 0.6 * kind.height_grey[0], kind.shrink,
                                 kind.width_px[1], kind.parts_px)
            seen.append(bodies[kind.members(bodies, np.ones(len(bodies), bool))])
        places += [place for place in standing(seen, carried) if not np.any(
            np.hypot(meant[:, 0] - place.x_px, meant[:, 1] - place.y_px) < 2 * place.radius_px)]
    return settings.model_copy(update={'standing': (*settings.standing, *places)})


def _compact(frame: np.ndarray, dark: bool) -> Bodies:
    bodies = find_bodies(frame, dark, _CLEAR * pixel_noise(frame) / _SHRINK, _SHRINK, _WIDEST)
    good = (bodies.length < _LONGEST) & (bodies.fill > _LEAST_FILL) & ~bodies.cut
    return bodies[good & (bodies.edge < _BLURRED * bodies.width)]


def _standing(seen: list[Bodies]) -> np.ndarray:
    places = standing(seen, carried=True)
    return np.array([(place.x_px, place.y_px, place.radius_px) for place in places]).reshape(-1, 3)


def _at(bodies: Bodies, places: np.ndarray) -> np.ndarray:
    away = np.hypot(bodies.xy[:, None, 0] - places[:, 0], bodies.xy[:, None, 1] - places[:, 1])
    return np.asarray(np.any(away < places[:, 2], axis=1))


def _energy(seen: list[Bodies]) -> float:
    return float(sum(np.sum((bodies.height * bodies.width) ** 2) for bodies in seen))


def needed(
    frames: list[np.ndarray], chosen: TrackerSettings, find: Finder | None, fitted: bool
) -> bool:
    """Whether what was `chosen` follows more in `frames` than the usual way to `find` particles.

    None stands for a usual way that has learned nothing. Where it has a picture that is `fitted`
    to each particle it is more exact, and kept unless it misses much; outlines are no more exact
    than those of a kind, which knows them better, and are kept only where they find more.
    """
    if find is None:
        return True
    detector = KindsDetector(chosen.kinds, chosen.standing)
    both = missed = more = 0
    for frame in frames:
        bodies = detector.detect(frame, np.empty((0, 2)))
        places = find(frame)
        near = np.linalg.norm(bodies.xy[:, None] - places, axis=2) < 2 * bodies.radius[:, None]
        both += int(near.any(axis=1).sum())
        missed += int((~near.any(axis=1)).sum())
        more += int((~near.any(axis=0)).sum())
    return both < _AGREED * (both + missed) if fitted else missed >= more
