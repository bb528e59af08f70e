"""Choice of what to follow without examples: bodies that move, are compact and in focus."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.tracking.locate.bodies import Bodies, find_bodies
from microbot_ros.tracking.locate.kinds import Kind
from microbot_ros.tracking.locate.kinds_detector import KindsDetector
from microbot_ros.tracking.locate.search import pixel_noise
from microbot_ros.tracking.locate.standing import Place, creeping, standing
from microbot_ros.tracking.settings import TrackerSettings
from microbot_ros.tracking.teach.learn import learn
from microbot_ros.tracking.teach.teacher import like
from microbot_ros.tracking.tracker import Detector, make_detector

_SAMPLES = 12
"""Choice: frames from all over a film by which motion is detected."""

_LEAST_FRAMES = 24
"""Choice: frames of a film from which its samples are searched for motion."""

_LEAST_SPECKS = 20
"""Choice: detections in a frame below which they are never taken for noise.

On a laboratory film a few bright marks beside one dark swimmer look like its negative.
"""

_MIRRORED = 0.2
"""Choice: detections in the negative over those in the frame from which they are noise.

Compression noise has 0.44 to 0.82, laboratory films of particles 0.00. At half of it a film with a
bright particle per ten dark ones would be noise; at twice it some noise would pass.
"""

_SHRINK, _WIDEST = 2, 120.0
"""Choices: pixels binned in the first search, and the widest body [px]."""

_CLEAR = 8.0
"""Choice: standard deviations of the noise by which a body must stand out."""

_LONGEST, _LEAST_FILL = 5.0, 0.55
"""Choices: length over width, and share of the ellipse around it, of a compact body."""

_BLURRED = 0.55
"""Choice: width of the edge over that of the body from which it is out of focus."""

_EXAMPLES = (0.5, 0.25, 0.75)
"""Choice: quantiles of contrast at which examples are taken from moving bodies."""

_AS_DARK = 0.5
"""Choice: least contrast of an example over that of the first."""

_AGREED = 0.7
"""Choice: share of moving bodies that the usual, more exact detector must find to be kept."""

Finder = Callable[[np.ndarray], np.ndarray]
"""Function from a picture (H, W) to positions (N, 2) [px] of its particles."""

_NOWHERE = np.empty((0, 2))  # no positions


def evenly(images: Iterable[np.ndarray], length: int | None) -> list[np.ndarray]:
    """Return 12 to 24 of the `images` of a film, evenly spread; all if there are fewer.

    `length` is the number of images that the film states, None if it states none.

    Parameters
    ----------
    images : iterable of ndarray
        The images.
    length : int or None
        Number of images, or None.

    Returns
    -------
    list of ndarray
        The selected images.
    """
    step = max(1, (length or 10 * _SAMPLES) // _SAMPLES)
    samples: list[np.ndarray] = []
    for index, image in enumerate(images):
        if index % step == 0:
            samples.append(image)
        if len(samples) > 2 * _SAMPLES:  # longer than stated: every second is enough
            samples, step = samples[::2], 2 * step
    return samples


def without_prompt(
    settings: TrackerSettings, samples: list[np.ndarray], length: int
) -> tuple[TrackerSettings, list[str]]:
    """Return the `settings` for a film without examples, and sentences on doubts.

    They have a kind for moving bodies in the `samples` (H, W), from all over the film, if the
    learned picture misses much of them, and no kind if the motion is noise. They are unchanged if
    they state the appearance of a particle, or for a film of less than 24 frames (`length`).

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    samples : list of ndarray
        Pictures (H, W) from all over the film.
    length : int
        Number of frames.

    Returns
    -------
    tuple[TrackerSettings, list of str]
        The settings and the sentences.
    """
    stated = (settings.contrast, settings.shape, settings.diameter_px) != (None, None, None)
    if stated or settings.kinds or length < _LEAST_FRAMES or len(samples) < 3:
        return settings, []
    found = choose(samples, settings)
    if found is not None and specks(KindsDetector(found.kinds, found.standing), samples):
        found = None
    appearance = learn(samples, settings)
    if appearance is None:
        return found or settings, []
    detector = make_detector(appearance, settings)
    if found is not None and needed(
            samples, found, lambda image: detector.detect(image, _NOWHERE).xy, appearance.round):
        return found, []
    count = specks(detector, samples)
    return settings, [
        f'{count} specks per frame are found, and as many in the negative of the film: this is '
        'noise; point at a particle with --like FRAME,X,Y'] if count else []


def specks(detector: Detector, samples: list[np.ndarray]) -> int:
    """Return the number of noise specks a `detector` finds in a frame; 0 if it finds particles.

    Noise has as many bright maxima as dark ones, so that a detector of noise finds as much in the
    negative of the `samples` (H, W); a detector of particles finds next to nothing there.

    Parameters
    ----------
    detector : Detector
        The detector.
    samples : list of ndarray
        Pictures (H, W) from all over the film.

    Returns
    -------
    int
        The number.
    """
    count = mirrored = 0
    for sample in samples:
        count += len(detector.detect(sample, _NOWHERE))
        if count < _LEAST_SPECKS:
            return 0
        negative = np.iinfo(sample.dtype).max - sample
        mirrored += len(detector.detect(negative, _NOWHERE))
    if count < _LEAST_SPECKS * len(samples) or mirrored < _MIRRORED * count:
        return 0
    return round(count / len(samples))


def choose(frames: list[np.ndarray], settings: TrackerSettings) -> TrackerSettings | None:
    """Return the `settings` with a kind for moving bodies in `frames` (H, W) from all over a film.

    None if nothing moves that is compact and in focus.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    settings : TrackerSettings
        Settings of the tracker.

    Returns
    -------
    TrackerSettings or None
        The settings, or None.
    """
    # Objects in the middle of the film may be hidden at its beginning, and the reverse.
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
    """Point at typical moving bodies, as a person would."""
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
    """Return the `settings` with places where still objects look like their kinds.

    `frames` are from all over a film. Places near `meant` points (M, 2) [px] are not included: a
    person who points at a resting body wants it followed. If `carried`, objects that drift with
    the sample are included.

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    frames : list of ndarray
        Pictures (H, W).
    meant : ndarray, shape (M, 2)
        Points at particles [px].
    carried : bool
        Whether objects that drift with the sample count.

    Returns
    -------
    TrackerSettings
        The settings.
    """
    places = [place for kind in settings.kinds
              for place in _unmeant(standing(_members(kind, frames), carried), meant)]
    return settings.replaced(standing=(*settings.standing, *places))


def without_creeping(
    settings: TrackerSettings, frames: list[np.ndarray], meant: np.ndarray, x: float, y: float
) -> tuple[TrackerSettings, int]:
    """Return the `settings` without bodies that stay in place like that at (`x`, `y`) [px].

    Nothing changes if the body at (x, y) moves by itself, or `meant` points (M, 2) [px] are there.
    The number of places left out is returned too. A place may creep by its own width. `frames` (H,
    W) are from all over a film.

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    frames : list of ndarray
        Pictures (H, W).
    meant : ndarray, shape (M, 2)
        Points at particles [px].
    x : float
        Column [px].
    y : float
        Row [px].

    Returns
    -------
    tuple[TrackerSettings, int]
        The settings and the number of places.
    """
    places = [place for kind in settings.kinds
              for place in _unmeant(creeping(_members(kind, frames)), meant)]
    if not any(place.holds(x, y) for place in places):
        return settings, 0
    return (settings.replaced(standing=(*settings.standing, *places)), len(places))


def _members(kind: Kind, frames: list[np.ndarray]) -> list[Bodies]:
    """Return the bodies in each of the `frames` (H, W) that are leniently of a `kind`."""
    seen = []
    for frame in frames:
        bodies = find_bodies(frame, kind.dark, 0.6 * kind.height_grey[0], kind.shrink,
                             kind.width_px[1], kind.parts_px)
        seen.append(bodies[kind.members(bodies, np.ones(len(bodies), bool))])
    return seen


def _unmeant(places: list[Place], meant: np.ndarray) -> list[Place]:
    """Return the `places` that are far from all `meant` points (M, 2) [px]."""
    return [place for place in places if not np.any(
        np.hypot(meant[:, 0] - place.x_px, meant[:, 1] - place.y_px) < 2 * place.radius_px)]


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
    frames: list[np.ndarray], chosen: TrackerSettings, find: Finder, fitted: bool
) -> bool:
    """Return whether the `chosen` kinds follow more in `frames` than the usual function `find`.

    If the usual detector has a picture `fitted` to each particle it is more exact, and kept unless
    it misses much. Outlines are less exact than kinds, and kept only if they find more.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    chosen : TrackerSettings
        Settings with the kinds.
    find : Finder
        Function that finds particles.
    fitted : bool
        Whether the usual detector fits a picture to each particle.

    Returns
    -------
    bool
        Whether the kinds replace the usual detector.
    """
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
