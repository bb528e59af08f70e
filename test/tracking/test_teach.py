"""Pointing: what is learned from one example, from corrections, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.tracking import Tracker, TrackerSettings
from microbot_ros.tracking.locate.bodies import Bodies
from microbot_ros.tracking.locate.kinds import Kind, with_examples
from microbot_ros.tracking.locate.kinds_detector import KindsDetector
from microbot_ros.tracking.locate.standing import standing
from microbot_ros.tracking.teach import teacher

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
    settings, said = teacher.like(TrackerSettings(), image, 61.0, 49.0)
    np.testing.assert_allclose(_found(settings, image), [_SMALL, _LARGE], atol=0.3)
    assert said.startswith('robot: learned from 1 example')


def test_a_counter_example_takes_out_what_is_like_it_and_only_that() -> None:
    image = _picture(*_SCENE)
    settings, _ = teacher.like(TrackerSettings(), image, *_SMALL)
    settings, _ = teacher.unlike(settings, image, *_LARGE)
    np.testing.assert_allclose(_found(settings, image), [_SMALL], atol=0.3)


def test_each_of_two_kinds_has_its_own() -> None:
    image = _picture(*_SCENE)
    settings, _ = teacher.like(TrackerSettings(), image, *_SMALL, 'small')
    settings, _ = teacher.like(settings, image, *_LARGE, 'large')
    found = KindsDetector(settings.kinds).detect(image, _NOWHERE)
    names = [settings.kinds[k].name for k in found.kind[np.argsort(found.xy[:, 0])]]
    assert names == ['small', 'large']


def test_a_bright_one_is_learned_as_bright() -> None:
    image = _picture((_SMALL, 5.0, 60.0), (_LARGE, 9.0, -80.0))
    settings, _ = teacher.like(TrackerSettings(), image, *_SMALL)
    assert settings.kinds[0].contrast == 'bright'
    np.testing.assert_allclose(_found(settings, image), [_SMALL], atol=0.3)


@pytest.mark.parametrize(('x', 'y', 'problem'), [
    (260.0, 180.0, 'nothing is visible'), (300.0, 20.0, 'a point in the image'),
    (-3.0, 20.0, 'a point in the image'), (math.nan, 20.0, 'a point in the image'),
    (math.inf, 20.0, 'a point in the image'), (80.0, 50.0, 'two are equally near')])
def test_points_that_mean_nothing_are_refused(x: float, y: float, problem: str) -> None:
    pair = ((70.0, 50.0), 5.0, -70.0), ((90.0, 50.0), 5.0, -70.0)
    image = _picture(*(pair if x == 80 else _SCENE))
    with pytest.raises(InputError, match=problem):
        teacher.like(TrackerSettings(), image, x, y)


@pytest.mark.parametrize('name', ['\x1b[2J', '2nd', 'a b', 'x' * 33, '-'])
def test_a_name_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(InputError, match='expected a name'):
        teacher.like(TrackerSettings(), _picture(*_SCENE), *_SMALL, name)


def test_examples_that_contradict_each_other_are_refused() -> None:
    image = _picture(*_SCENE)
    settings, _ = teacher.like(TrackerSettings(), image, *_SMALL)
    with pytest.raises(InputError, match='this is one of them'):
        teacher.unlike(settings, image, *_SMALL)
    with pytest.raises(InputError, match='an example first'):
        teacher.unlike(TrackerSettings(), image, *_SMALL)


def test_what_was_learned_survives_a_file(tmp_path: Path) -> None:
    settings, _ = teacher.like(TrackerSettings(), _picture(*_SCENE), *_SMALL, 'robot')
    file = tmp_path / 'learned.yaml'
    file.write_text(yaml.safe_dump(settings.content('changed')))
    assert read_yaml(file, TrackerSettings) == settings


def test_a_taught_tracker_follows_at_once_and_says_the_kind() -> None:
    settings, _ = teacher.like(TrackerSettings(), _picture(*_SCENE), *_SMALL)
    tracker = Tracker(settings)
    for t in range(6):
        moved = [((x + t, y), radius, contrast) for (x, y), radius, contrast in _SCENE]
        poses = tracker.update(_picture(*moved, seed=t), t / 10)
    assert tracker.ready
    assert poses.id.tolist() == [0, 1]
    assert poses.kind.tolist() == [0, 0]


def test_teaching_goes_on_with_the_identities() -> None:
    settings, _ = teacher.like(TrackerSettings(), _picture(*_SCENE), *_SMALL)
    tracker = Tracker(settings)
    for t in range(6):
        before = tracker.update(_picture(*_SCENE, seed=t), t / 10)
    more, _ = teacher.like(settings, _picture(*_SCENE), *_LARGE)
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


def test_without_pointing_what_only_drifts_with_the_sample_does_not_move() -> None:
    rng = np.random.default_rng(6)
    noise = rng.normal(0, 0.2, (12, 2))
    stuck = np.array([20.0, 20.0]) + np.outer(np.arange(12), [0.3, 0.2]) + noise
    swims = np.array([90.0, 20.0]) + np.outer(np.arange(12), [1.0, 0.8]) + noise
    wander = np.array([20.0, 90.0]) + np.cumsum(rng.normal(0, 0.25, (12, 2)), axis=0)
    seen = [_bodies(np.array(rows)) for rows in zip(stuck, swims, wander, strict=True)]
    assert standing(seen) == []
    place, = standing(seen, carried=True)
    assert np.hypot(*(stuck - [place.x_px, place.y_px]).T).max() < place.radius_px


def test_a_kind_that_is_forgotten_takes_its_particles_along_and_no_identity_comes_twice() -> None:
    settings, _ = teacher.like(TrackerSettings(), _picture(*_SCENE), *_SMALL, 'small')
    settings, _ = teacher.like(settings, _picture(*_SCENE), *_LARGE, 'large')
    tracker = Tracker(settings)
    for t in range(6):
        before = tracker.update(_picture(*_SCENE, seed=t), t / 10)
    names = dict(zip(before.kind.tolist(), before.id.tolist(), strict=True))
    fewer, _ = teacher.forget(settings, 'small')
    tracker.teach(fewer)
    after = tracker.update(_picture(*_SCENE, seed=9), 0.7)
    assert (after.id.tolist(), after.kind.tolist()) == ([names[1]], [0])
    tracker.teach(teacher.forget(fewer)[0])
    assert len(tracker.update(_picture(*_SCENE, seed=10), 0.8)) == 0
    tracker.teach(settings)
    for t in range(6):
        again = tracker.update(_picture(*_SCENE, seed=t), 1 + t / 10)
    assert len(again) == 2
    assert not set(again.id.tolist()) & set(before.id.tolist())


def test_what_the_edge_cuts_is_followed_only_where_it_is_known() -> None:
    settings, _ = teacher.like(TrackerSettings(), _picture(*_SCENE), *_LARGE)
    detector, edge = KindsDetector(settings.kinds), (2.0, 100.0)
    image = _picture((edge, 9.0, -80.0))
    assert len(detector.detect(image, _NOWHERE)) == 0
    assert len(detector.detect(image, np.array([[4.0, 100.0]]))) == 1


@pytest.mark.parametrize('radius', [5.0, 9.0])
def test_the_edge_pulls_at_no_disc_that_it_cuts(radius: float) -> None:
    settings, _ = teacher.like(TrackerSettings(), _picture((_SMALL, radius, -70.0)), *_SMALL)
    detector, rng, off, told = KindsDetector(settings.kinds), np.random.default_rng(6), [], []
    for seed, x in enumerate(np.linspace(-1, radius + 2, 60).tolist()):
        place = (x, 100 + rng.uniform(-0.5, 0.5))
        found = detector.detect(
            _picture((place, radius, -70.0), seed=seed), np.array([[max(x, 2.0), 100.0]]))
        off.append(found.xy[0] - place)
        told.append(found.sigma[0])
    assert np.abs(np.mean(off, axis=0)).max() < 0.01
    assert 0.7 < np.sqrt(np.mean((off / np.array(told)[:, None]) ** 2)) < 1.5


def _rod(place: tuple[float, float], half: float, radius: float, angle: float, noise: float,
         rng: np.random.Generator) -> np.ndarray:
    v, u = np.mgrid[:120, :160].astype(float) - np.array(place)[::-1, None, None]
    along = np.clip(u * math.cos(angle) + v * math.sin(angle), -half, half)
    away = np.hypot(u - along * math.cos(angle), v - along * math.sin(angle))
    drawn = 120 - 70 / (1 + np.exp(1.6 * (away - radius))) + rng.normal(0, noise, away.shape)
    return np.clip(np.rint(drawn), 0, 255).astype(np.uint8)


@pytest.mark.parametrize('angle', [0.0, 0.4, 1.2])
@pytest.mark.parametrize(('half', 'radius', 'noise'), [
    (9, 4, 1.5), (14, 5, 4.0), (7, 2.5, 2.0), (20, 8, 3.0)])
def test_the_place_of_a_rod_is_as_exact_as_it_says(
    half: float, radius: float, noise: float, angle: float,
) -> None:
    rng, off, told = np.random.default_rng(3), [], []
    settings, _ = teacher.like(
        TrackerSettings(), _rod((80, 60), half, radius, angle, noise, rng), 80.0, 60.0)
    detector = KindsDetector(settings.kinds)
    for _ in range(60):
        place = (80 + rng.uniform(-0.5, 0.5), 60 + rng.uniform(-0.5, 0.5))
        found = detector.detect(_rod(place, half, radius, angle, noise, rng), _NOWHERE)
        off.append(found.xy[0] - place)
        told.append(found.sigma[0])
    error = float(np.sqrt(np.mean(np.square(off))))
    assert np.abs(np.mean(off, axis=0)).max() < float(np.mean(told))
    assert 0.7 < error / float(np.mean(told)) < 1.25


def test_the_place_of_a_rod_that_the_edge_cuts_is_in_doubt() -> None:
    def rod(x: float) -> np.ndarray:
        return _rod((x, 60.0), 9, 4, 0.0, 1.5, np.random.default_rng(4))

    settings, _ = teacher.like(TrackerSettings(), rod(80.0), 80.0, 60.0)
    detector = KindsDetector(settings.kinds)
    for x in (3.0, 6.0, 9.0):
        found = detector.detect(rod(x), np.array([[x, 60.0]]))
        assert abs(found.xy[0, 0] - x) < 2.5 * found.sigma[0]
    assert detector.detect(rod(15.0), _NOWHERE).sigma[0] < 0.1


def test_what_hardly_diffuses_is_no_dirt() -> None:
    rng = np.random.default_rng(5)
    slow = np.array([50.0, 50.0]) + np.cumsum(rng.normal(0, 0.5, (12, 2)), axis=0)
    passed = np.array([20.0, 20.0]) + rng.normal(0, 0.1, (12, 2))
    passed[5] += 2.5  # something goes by
    places = standing([_bodies(np.array(rows)) for rows in zip(slow, passed, strict=True)])
    assert [(round(place.x_px), round(place.y_px)) for place in places] == [(20, 20)]


def test_what_is_smaller_and_paler_at_once_is_another_thing() -> None:
    image = _picture(*_SCENE)
    settings, _ = teacher.like(TrackerSettings(), image, *_LARGE)
    assert len(_found(settings, _picture((_SMALL, 4.6, -80.0)))) == 1
    assert len(_found(settings, _picture((_SMALL, 9.0, -45.0)))) == 1
    assert len(_found(settings, _picture((_SMALL, 4.0, -42.0)))) == 0


def test_one_that_passes_by_bright_things_is_followed_on() -> None:
    settings, _ = teacher.like(TrackerSettings(), _picture(*_SCENE), *_SMALL)
    tracker = Tracker(settings)
    for t in range(40):
        place = (40.0 + 3 * t, 60.0)
        poses = tracker.update(_picture((place, 5.0, -70.0), ((100.0, 76.0), 9.0, 60.0), seed=t),
                               t / 10)
        if t > 3:
            np.testing.assert_allclose(poses.xy[poses.seen], [place], atol=0.6)
    assert poses.id.tolist() == [0]


@pytest.mark.parametrize(('apart', 'found'), [
    (10.0, [(85.0, 60.0), (200.0, 125.0)]),
    (14.0, [(80.0, 60.0), (94.0, 60.0), (200.0, 120.0), (200.0, 134.0)])])
def test_a_doublet_is_one_body_where_its_halves_touch_and_its_parts_where_light_is_between(
    apart: float, found: list[tuple[float, float]]
) -> None:
    image = _picture(*(((x, y), 5.0, -70.0) for x, y in (
        (80.0, 60.0), (80.0 + apart, 60.0), (200.0, 120.0), (200.0, 120.0 + apart))))
    settings, _ = teacher.like(TrackerSettings(), image, 80.0, 60.0)
    places = sorted(map(tuple, _found(settings, image).round()))
    np.testing.assert_array_equal(places, found)


def test_a_point_in_the_light_between_two_parts_means_both_as_one_body() -> None:
    parts = [(80.0, 60.0), (94.0, 60.0), (200.0, 120.0), (200.0, 134.0), (60.0, 150.0)]
    image = _picture(*((place, 5.0, -70.0) for place in parts))
    settings, said = teacher.like(TrackerSettings(), image, 87.0, 60.0, 'pair')
    assert 'taken as one' in said
    np.testing.assert_allclose(_found(settings, image),
                               [parts[-1], (87.0, 60.0), (200.0, 127.0)], atol=0.3)
    settings, _ = teacher.unlike(settings, image, *parts[-1])
    np.testing.assert_allclose(_found(settings, image), [(87.0, 60.0), (200.0, 127.0)], atol=0.3)
    settings, said = teacher.like(TrackerSettings(), image, *parts[0])
    assert 'taken as one' not in said
    assert len(_found(settings, image)) == 5


def test_a_point_between_the_links_of_a_chain_means_the_chain() -> None:
    links = [(100.0 + 10 * k, 60.0 + 10 * k) for k in range(4)]
    image = _picture(*((place, 5.0, -70.0) for place in links))
    settings, _ = teacher.like(TrackerSettings(), image, 115.0, 75.0, 'chain')
    np.testing.assert_allclose(_found(settings, image), [(115.0, 75.0)], atol=0.3)


def test_what_is_rounder_than_its_example_is_not_odd_for_that() -> None:
    kind = with_examples(Kind(), [(64.0, 12.3, 2.1, 1.018, 0.99, 0.05)], [], 0.0)
    bodies = replace(_bodies(np.zeros((2, 2))), height=np.full(2, 64.0), width=np.full(2, 31.7),
                     edge=np.full(2, 2.1), length=np.array([1.018, 1.0]), halo=np.full(2, 0.06))
    assert kind.members(bodies, np.zeros(2, bool)).all()


def test_what_is_unlike_one_of_two_kinds_of_opposite_sign_needs_no_name() -> None:
    robot, bead = (60.0, 60.0), (60.0, 140.0)
    image = _picture((robot, 5.0, -60.0), (bead, 5.0, 60.0), (_LARGE, 9.0, -60.0))
    settings, _ = teacher.like(TrackerSettings(), image, *robot, 'robot')
    settings, _ = teacher.like(settings, image, *bead, 'bead')
    settings, said = teacher.unlike(settings, image, *_LARGE)
    assert said.startswith('robot: not bodies')
    with pytest.raises(InputError, match='nothing is visible there'):
        teacher.unlike(settings, image, 280.0, 190.0)


def test_where_nothing_is_taught_nothing_is_forgotten_or_unlike() -> None:
    with pytest.raises(InputError, match='expected a taught kind'):
        teacher.forget(TrackerSettings())
    with pytest.raises(InputError, match='expected an example of robot first'):
        teacher.unlike(TrackerSettings(kinds=(Kind(),)), _picture(*_SCENE), *_SMALL)


@pytest.mark.parametrize(('content', 'problem'), [
    ({'kinds': [{'name': 'a'}, {'name': 'a'}]}, 'different names; received a twice'),
    ({'kinds': [{'name': 'a', 'width_px': [60, 3]}]}, 'the lower end first'),
    ({'kinds': [{'name': 'a', 'width_px': [0, 3]}]}, 'widths above 0'),
    ({'kinds': [{'name': 'a\n'}]}, 'name')])
def test_kinds_that_cannot_be_are_refused(content: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        TrackerSettings.from_content(content)
