"""Pointing: what is learned from one example, from corrections, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from microbot_ros.errors import InputError
from microbot_ros.files import read_yaml
from microbot_ros.tracking import Tracker, TrackerSettings, teach
from microbot_ros.tracking.bodies import Bodies
from microbot_ros.tracking.kinds_detector import KindsDetector
from microbot_ros.tracking.standing import standing

_SMALL, _LARGE, _PALE = (60.0, 50.0), (200.0, 70.0), (120.0, 140.0)
_NOWHERE = np.empty((0, 2))


def _picture(*discs: tuple[tuple[float, float], float, float], seed: int = 1) -> np.ndarray:
    """Discs, each of a place, a radius and a contrast, on even light: (200, 300) uint8."""
    v, u = np.mgrid[:200, :300]
    light = 150 + np.random.default_rng(seed).normal(0, 1.5, u.shape)
    for (x, y), radius, contrast in discs:
        light += contrast / (1 + np.exp(1.6 * (np.hypot(u - x, v - y) - radius)))
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


_SCENE = ((_SMALL, 5.0, -70.0), (_LARGE, 9.0, -80.0), (_PALE, 7.0, -12.0))


def _found(settings: TrackerSettings, image: np.ndarray) -> np.ndarray:
    places = KindsDetector(settings.kinds, settings.standing).detect(image, _NOWHERE).xy
    return places[np.argsort(places[:, 0])]


def test_one_example_finds_those_like_it_of_other_sizes_and_no_pale_one() -> None:
    image = _picture(*_SCENE)
    settings, said = teach.like(TrackerSettings(), image, 61.0, 49.0)
    np.testing.assert_allclose(_found(settings, image), [_SMALL, _LARGE], atol=0.3)
    assert said.startswith('robot: learned from 1 example')


def test_a_counter_example_takes_out_what_is_like_it_and_only_that() -> None:
    image = _picture(*_SCENE)
    settings, _ = teach.like(TrackerSettings(), image, *_SMALL)
    settings, _ = teach.unlike(settings, image, *_LARGE)
    np.testing.assert_allclose(_found(settings, image), [_SMALL], atol=0.3)


def test_each_of_two_kinds_has_its_own() -> None:
    image = _picture(*_SCENE)
    settings, _ = teach.like(TrackerSettings(), image, *_SMALL, 'small')
    settings, _ = teach.like(settings, image, *_LARGE, 'large')
    found = KindsDetector(settings.kinds).detect(image, _NOWHERE)
    names = [settings.kinds[k].name for k in found.kind[np.argsort(found.xy[:, 0])]]
    assert names == ['small', 'large']


def test_a_bright_one_is_learned_as_bright() -> None:
    image = _picture((_SMALL, 5.0, 60.0), (_LARGE, 9.0, -80.0))
    settings, _ = teach.like(TrackerSettings(), image, *_SMALL)
    assert settings.kinds[0].contrast == 'bright'
    np.testing.assert_allclose(_found(settings, image), [_SMALL], atol=0.3)


@pytest.mark.parametrize(('x', 'y', 'problem'), [
    (260.0, 180.0, 'nothing stands out'), (300.0, 20.0, 'a point in the picture'),
    (-3.0, 20.0, 'a point in the picture'), (math.nan, 20.0, 'a point in the picture'),
    (math.inf, 20.0, 'a point in the picture'), (80.0, 50.0, 'two are as near')])
def test_points_that_mean_nothing_are_refused(x: float, y: float, problem: str) -> None:
    pair = ((70.0, 50.0), 5.0, -70.0), ((90.0, 50.0), 5.0, -70.0)
    image = _picture(*(pair if x == 80 else _SCENE))
    with pytest.raises(InputError, match=problem):
        teach.like(TrackerSettings(), image, x, y)


def test_examples_that_contradict_each_other_are_refused() -> None:
    image = _picture(*_SCENE)
    settings, _ = teach.like(TrackerSettings(), image, *_SMALL)
    with pytest.raises(InputError, match='this is one of them'):
        teach.unlike(settings, image, *_SMALL)
    with pytest.raises(InputError, match='an example first'):
        teach.unlike(TrackerSettings(), image, *_SMALL)


def test_what_was_learned_survives_a_file(tmp_path: Path) -> None:
    settings, _ = teach.like(TrackerSettings(), _picture(*_SCENE), *_SMALL, 'robot')
    file = tmp_path / 'learned.yaml'
    file.write_text(yaml.safe_dump(settings.model_dump(mode='json', exclude_defaults=True)))
    assert read_yaml(file, TrackerSettings) == settings


def test_a_taught_tracker_follows_at_once_and_says_the_kind() -> None:
    settings, _ = teach.like(TrackerSettings(), _picture(*_SCENE), *_SMALL)
    tracker = Tracker(settings)
    for t in range(6):
        moved = [((x + t, y), radius, contrast) for (x, y), radius, contrast in _SCENE]
        poses = tracker.update(_picture(*moved, seed=t), t / 10)
    assert tracker.ready
    assert poses.id.tolist() == [0, 1]
    assert poses.kind.tolist() == [0, 0]


def test_teaching_goes_on_with_the_identities() -> None:
    settings, _ = teach.like(TrackerSettings(), _picture(*_SCENE), *_SMALL)
    tracker = Tracker(settings)
    for t in range(6):
        before = tracker.update(_picture(*_SCENE, seed=t), t / 10)
    more, _ = teach.like(settings, _picture(*_SCENE), *_LARGE)
    tracker.teach(more)
    after = tracker.update(_picture(*_SCENE, seed=9), 0.7)
    assert after.id.tolist() == before.id.tolist()


def _bodies(places: np.ndarray) -> Bodies:
    one = np.ones(len(places))
    return Bodies(places, 50 * one, 10 * one, one, one, one, one, one, one > 2, places, places,
                  one, one)


def test_dirt_stands_still_and_what_drifts_or_wanders_does_not() -> None:
    rng = np.random.default_rng(2)
    dirt = np.array([20.0, 20.0]) + rng.normal(0, 0.2, (12, 2))
    drift = np.array([90.0, 20.0]) + np.outer(np.arange(12), [0.2, 0.1])
    wander = np.array([20.0, 90.0]) + np.cumsum(rng.normal(0, 0.25, (12, 2)), axis=0)
    places = standing([_bodies(np.array(rows)) for rows in zip(dirt, drift, wander, strict=True)])
    assert [(round(place.x_px), round(place.y_px)) for place in places] == [(20, 20)]
