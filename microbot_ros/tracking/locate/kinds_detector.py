"""Detector of all bodies of the taught kinds in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from microbot_ros.tracking.locate.bodies import Bodies, find_bodies
from microbot_ros.tracking.locate.detect import Detections
from microbot_ros.tracking.locate.kinds import Kind
from microbot_ros.tracking.locate.search import pixel_noise
from microbot_ros.tracking.locate.standing import Place
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.refine.disc_fit import refine
from microbot_ros.tracking.refine.fit import TABLE_STEP

_KNOWN = 0.7
"""Choice: widths from its expectation within which a known body is recognised leniently."""

_SAME = 0.5
"""Choice: widths below which two bodies are the same."""

_LEAST_SIGMA = 0.02
"""Choice: least error [px] of the centroid of a changing shape."""

_CUT = 0.2
"""Choice: error, in widths, of a body cut by the edge of the picture."""

_HEADED = 1.6
"""Choice: length over width from which a body has a direction."""


class KindsDetector:
    """Finds bodies and assigns each to one of the `kinds`.

    Nothing is found at the `standing` places. `remark` describes problems of the last picture, ''
    if there are none.

    Parameters
    ----------
    kinds : sequence of Kind
        The kinds.
    standing : sequence of Place
        Places at which nothing is found.
    """

    def __init__(self, kinds: Sequence[Kind], standing: Sequence[Place] = ()) -> None:
        self.kinds = tuple(kinds)
        self.remark = ''
        self._standing = np.array([(place.x_px, place.y_px, place.radius_px)
                                   for place in standing]).reshape(-1, 3)
        self._looks: dict[tuple[bool, int, float], list[int]] = {}
        for k, kind in enumerate(self.kinds):
            self._looks.setdefault((kind.dark, kind.shrink, kind.parts_px), []).append(k)

    def detect(self, image: np.ndarray, expected: np.ndarray) -> Detections:
        """Return all bodies of these kinds in `image` (H, W).

        A body near an `expected` position (M, 2) [px] may look less like its kind.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        expected : ndarray, shape (M, 2)
            Predicted positions [px].

        Returns
        -------
        Detections
            The detections.
        """
        noise = pixel_noise(image)
        found = [self._look(image, expected, noise, *look) for look in self._looks]
        every, strange = _joined([part for part, _ in found]), np.concatenate(
            [strange for _, strange in found])
        return every[_apart(every, strange)]

    def _look(
        self, image: np.ndarray, expected: np.ndarray, noise: float, dark: bool, shrink: int,
        parts_px: float,
    ) -> tuple[Detections, np.ndarray]:
        """Return bodies of all kinds with one sign and resolution, and their strangeness."""
        chosen = self._looks[dark, shrink, parts_px]
        kinds = [self.kinds[k] for k in chosen]
        least = min(kind.height_grey[0] for kind in kinds)
        widest = max(kind.width_px[1] for kind in kinds)
        bodies = find_bodies(image, dark, 0.6 * least, shrink, widest, parts_px, expected)
        bodies = bodies[~self._stands(bodies)]
        lenient = _near(bodies, expected)
        strange = np.array([
            np.where(kind.members(bodies, lenient), kind.strangeness(bodies), np.inf)
            for kind in kinds])
        best = np.argmin(strange, axis=0)
        least_strange = strange[best, np.arange(len(bodies))]
        good = np.isfinite(least_strange)
        found = _detections(bodies[good], np.array(chosen)[best[good]], noise / shrink, shrink)
        return _refined(found, image, bodies[good], dark, noise), least_strange[good]

    def _stands(self, bodies: Bodies) -> np.ndarray:
        """Return whether each body (N,) is at one of the excluded places."""
        away = np.hypot(bodies.xy[:, None, 0] - self._standing[:, 0],
                        bodies.xy[:, None, 1] - self._standing[:, 1])
        return np.asarray(np.any(away < self._standing[:, 2], axis=1))


def _near(bodies: Bodies, expected: np.ndarray) -> np.ndarray:
    """Return which bodies (N,) are near `expected` positions (M, 2)."""
    if len(expected) == 0 or len(bodies) == 0:
        return np.zeros(len(bodies), bool)
    away = np.linalg.norm(bodies.xy[:, None] - expected, axis=2)
    return np.asarray(away.min(axis=1) < _KNOWN * bodies.width)


def _detections(bodies: Bodies, kind: np.ndarray, noise: float, shrink: int) -> Detections:
    sigma = noise / bodies.height * np.sqrt(bodies.spread / 2) / bodies.weight * shrink
    least = np.where(bodies.cut, _CUT * bodies.width, _LEAST_SIGMA)
    return Detections(
        xy=bodies.xy, sigma=np.maximum(sigma, least),
        theta=np.where(bodies.length > _HEADED, bodies.angle, np.nan),
        contrast=bodies.height, radius=bodies.width / 2, quality=bodies.fill, kind=kind)


def _refined(
    found: Detections, image: np.ndarray, bodies: Bodies, dark: bool, noise: float
) -> Detections:
    """Return the detections with precise positions of round bodies."""
    places, sigma, fitted = refine(
        image, bodies.xy, bodies.width / 2, bodies.edge, (-1.0 if dark else 1.0) * bodies.height,
        bodies.length, bodies.cut, noise)
    return replace(found, xy=places, sigma=np.where(fitted, sigma, found.sigma))


def _joined(parts: list[Detections]) -> Detections:
    return Detections(*(np.concatenate([getattr(part, name) for part in parts])
                        for name in Detections.__dataclass_fields__))


def _apart(found: Detections, strange: np.ndarray) -> np.ndarray:
    """Return the rows that remain if the stranger of any two identical ones is removed."""
    left: list[int] = []
    for k in np.argsort(strange, kind='stable'):
        away = np.linalg.norm(found.xy[left] - found.xy[k], axis=1)
        if not np.any(away < _SAME * 2 * np.maximum(found.radius[left], found.radius[k])):
            left.append(int(k))
    return np.array(sorted(left), int)


def stand_in(kinds: Sequence[Kind]) -> Appearance:
    """Return usual size and contrast of `kinds` as an appearance, for linking and drawing.

    Parameters
    ----------
    kinds : sequence of Kind
        The kinds.

    Returns
    -------
    Appearance
        The appearance.
    """
    width = float(np.median([kind.typical_width_px for kind in kinds]))
    height = float(np.median([np.exp(kind.typical[0]) for kind in kinds]))
    radii = np.arange(0, width, TABLE_STEP)
    sign = -1.0 if kinds[0].dark else 1.0
    return Appearance(
        table=sign / (1 + np.exp(2 * (radii[None] - width / 2))), reach_px=width,
        diameter_px=width, contrast_grey=height,
        min_contrast_grey=min(kind.height_grey[0] for kind in kinds), round=False)
