"""One counter-example on a gap between cells leaves out all that stay where they are."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.cli.track.learn import Point, pointed
from microbot_ros.common.errors import InputError
from microbot_ros.tracking import TrackerSettings
from microbot_ros.tracking.locate.bodies import Bodies
from microbot_ros.tracking.locate.kinds_detector import KindsDetector
from microbot_ros.tracking.locate.standing import creeping

_PICTURES = 12
_V, _U = np.mgrid[:200, :320]


def _film() -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Pictures of two robots and eight gaps that look like them, and the places of both [px]."""
    rng = np.random.default_rng(4)
    gaps = np.array([(30 + 65 * (k % 5), 30 + 65 * (k // 5)) for k in range(8)], float)
    places, pictures = [], []
    for t in range(_PICTURES):
        gaps = gaps + rng.normal(0, 0.6, gaps.shape)
        robots = np.array([(40 + 20 * t, 165), (290 - 20 * t, 128)], float)
        picture = 150 + rng.normal(0, 2, _U.shape)
        for x, y in (*gaps, *robots):
            picture -= 70 / (1 + np.exp(1.5 * (np.hypot(_U - x, _V - y) - 6)))
        pictures.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
        places.append(np.vstack([robots, gaps]))
    return pictures, np.array(places)[:, :2], np.array(places)[:, 2:]


def _found(settings: TrackerSettings, picture: np.ndarray) -> np.ndarray:
    detector = KindsDetector(settings.kinds, settings.standing)
    return detector.detect(picture, np.empty((0, 2))).xy


def test_one_counter_example_on_a_gap_ends_all() -> None:
    film, robots, gaps = _film()
    like, unlike = Point(0, *robots[0, 0]), Point(0, *gaps[0, 3])
    before, _ = pointed(TrackerSettings(), [like], [], {0: film[0]}, film)
    assert len(_found(before, film[0])) > 2
    after, said = pointed(TrackerSettings(), [like], [unlike], {0: film[0]}, film)
    assert after.kinds == before.kinds  # the robots look like the gaps: nothing to tell them by
    assert 'as 7 others do' in said[-1]
    for t in (0, 5, _PICTURES - 1):
        found = _found(after, film[t])
        away = np.linalg.norm(found[:, None] - robots[t], axis=2)
        assert away.shape == (2, 2)
        assert away.min(axis=1).max() < 0.5


def test_a_counter_example_on_what_moves_still_goes_by_its_look() -> None:
    film, robots, _ = _film()
    with pytest.raises(InputError, match='by size, contrast, sharpness and shape'):
        pointed(TrackerSettings(), [Point(0, *robots[0, 0])], [Point(0, *robots[0, 1])],
                {0: film[0]}, film)


@pytest.mark.parametrize(('step', 'places'), [(0.0, 1), (0.5, 1), (2.0, 0), (5.0, 0)])
def test_what_strays_by_more_than_its_width_does_not_creep(step: float, places: int) -> None:
    seen = []
    for k in range(_PICTURES):
        one = np.ones(1)
        seen.append(Bodies(
            np.array([[50 + step * k, 50.0]]), *[one * 8] * 7, one < 0,
            *[np.zeros((1, 2))] * 2, *[one] * 2))
    assert len(creeping(seen)) == places
