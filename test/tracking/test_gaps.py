"""Those who are lost take their names again, and who may be another says so."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from microbot_ros.tracking import Appearance, Tracker, TrackerSettings
from microbot_ros.tracking.link.doubt import together
from microbot_ros.tracking.link.linker import Linker
from microbot_ros.tracking.locate.detect import Detections
from microbot_ros.tracking.rows import Remarks
from microbot_ros.tracking.teach import teacher

_SIDE = 600


def _linker(merging: bool = False) -> Linker:
    """One for round particles, or for outlines that run into one."""
    looks = Appearance(
        table=np.zeros((1, 9)), reach_px=8.0, diameter_px=10.0, contrast_grey=60.0,
        min_contrast_grey=20.0, round=not merging)
    return Linker(TrackerSettings(), looks, (_SIDE, _SIDE))


def _seen(places: np.ndarray, radius: np.ndarray, rng: np.random.Generator) -> Detections:
    """Detections at `places` (N, 2), of `radius` (N,)."""
    one = np.ones(len(places))
    return Detections(
        xy=places + rng.normal(0, 0.1, places.shape), sigma=0.1 * one, theta=np.nan * one,
        contrast=60 * one, radius=radius, quality=one, kind=np.zeros(len(places), int))


def _walk(frames: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Places (frames, count, 2) of particles that diffuse about the middle of the picture."""
    start = rng.uniform(0.3 * _SIDE, 0.7 * _SIDE, (count, 2))
    return np.asarray(start + np.cumsum(rng.normal(0, 1.5, (frames, count, 2)), axis=0))


def _name_at(linker: Linker, place: np.ndarray) -> int:
    away = np.linalg.norm(linker.states.measured - place, axis=1)
    return int(linker.states.id[np.argmin(away)]) if away.min(initial=np.inf) < 5 else -1


def _follow(linker: Linker, path: np.ndarray, there: np.ndarray, radius: np.ndarray,
            rng: np.random.Generator) -> list[list[int]]:
    """Names by frame and particle of those who go along a `path` (T, N, 2), where `there` (T, N).
    """
    names = []
    for t, places in enumerate(path):
        if t:
            linker.predict(0.1, 0j)
        linker.update(_seen(places[there[t]], radius[there[t]], rng))
        names.append([_name_at(linker, place) for place in places])
    return names


@pytest.mark.parametrize('gap', [30, 80])
def test_one_who_is_lost_for_long_takes_its_name_again(gap: int) -> None:
    rng = np.random.default_rng(gap)
    path = _walk(120 + gap, 4, rng)
    there = np.ones((len(path), 4), bool)
    there[60:60 + gap, 1] = False
    linker = _linker()
    names = _follow(linker, path, there, np.full(4, 5.0), rng)
    assert names[-1] == names[59]
    assert sorted(names[-1]) == [0, 1, 2, 3]


def test_a_stranger_takes_no_name_of_one_who_looks_otherwise_or_cannot_be_there() -> None:
    rng = np.random.default_rng(3)
    path = _walk(160, 3, rng)
    path[:, 1] = path[59, 0] + [5.0, 0.0]  # there, but of another size
    path[:, 2] = [30.0, 30.0]  # alike, but where it can't have come to
    there = np.ones((160, 3), bool)
    there[60:, 0], there[:100, 1:] = False, False
    names = _follow(_linker(), path, there, np.array([5.0, 14.0, 5.0]), rng)
    assert names[59][0] == 0
    assert names[-1][1:] == [1, 2] or names[-1][1:] == [2, 1]


def _two_lost(seed: int) -> tuple[int, int, float, float]:
    """Two alike are lost, near one another, and come back: the wrong names, those of them of which
    nothing was said, the mean doubt, and the greatest error of place over σ.
    """
    rng = np.random.default_rng(seed)
    path = _walk(130, 2, rng)
    path[:, 1] += path[60, 0] - path[60, 1] + [14.0, 0.0]
    there = np.ones((130, 2), bool)
    there[61:100] = False
    linker = _linker()
    before = _follow(linker, path[:61], there[:61], np.full(2, 5.0), rng)[-1]
    after = _follow(linker, path[61:104], there[61:104], np.full(2, 5.0), rng)[-1]
    wrong = [k for k in range(2) if after[k] in before and after[k] != before[k]]
    states = linker.states
    silent = [k for k in wrong if f'doubt {after[k]}' not in linker.doubts]
    spread = np.sqrt(states.sigma**2 + states.doubt * states.astray)
    away = np.linalg.norm(path[103, 0] - path[103, 1]) if wrong else 0.0
    return len(wrong), len(silent), float(states.doubt.mean()), float(away / spread.min())


def test_two_who_come_back_alike_say_so_and_none_is_silently_the_other() -> None:
    wrong, silent, doubt, off = np.array([_two_lost(seed) for seed in range(24)]).T
    assert wrong.sum() >= 4  # else nothing is shown
    assert silent.sum() == 0
    assert wrong.mean() / 2 < doubt.mean() < 0.5
    assert off.max() < 4


def test_sigma_grows_while_one_may_be_two_and_who_is_followed_on_is_taken_for_what_it_is() -> None:
    rng = np.random.default_rng(8)
    path = _walk(150, 2, rng)
    path[:, 1] = path[:, 0] + [12.0, 0.0]
    there = np.ones((150, 2), bool)
    there[60:100] = False
    linker, spread, said = _linker(), [], []
    for t in range(150):
        _follow(linker, path[t:t + 1], there[t:t + 1], np.full(2, 5.0), rng)
        linker.predict(0.1, 0j)
        states = linker.states
        spread.append(float(np.sqrt(np.max(states.doubt * states.astray, initial=0.0))))
        said.append(sorted(linker.doubts.values()))
    assert said[59] == []
    assert spread[59] == 0.0
    assert [sentence.split(':')[0] for sentence in said[103]] == [
        'particle 0 may be two', 'particle 1 may be two']
    assert 3.0 < spread[103] < spread[110] < spread[118]
    assert said[-1] == []
    assert spread[-1] == 0.0


def test_of_two_that_pass_in_one_outline_the_tracker_says_that_they_may_be_two() -> None:
    v, u = np.mgrid[:120, :240]
    rng = np.random.default_rng(1)

    def picture(t: int) -> np.ndarray:
        light = 150 + rng.normal(0, 1.5, u.shape)
        for x in (60 + 2 * t, 180 - 2 * t):
            light -= 70 / (1 + np.exp(1.6 * (np.hypot(u - x, v - 60) - 8)))
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)

    settings, _ = teacher.like(TrackerSettings(), picture(0), 60.0, 60.0)
    tracker = Tracker(settings)
    poses = [tracker.update(picture(t), t / 10) for t in range(25)]
    assert tracker.remarks == {}
    poses += [tracker.update(picture(t), t / 10) for t in range(25, 40)]
    assert sorted(tracker.remarks) == ['doubt 0', 'doubt 1']
    assert poses[-1].seen.all()
    assert poses[-1].sigma_px.min() > 5 > 1 > poses[20].sigma_px.max()


def _comes_and_goes(t: int) -> tuple[float, float]:
    return 60.0 + 2 * min(t, 22), 70.0 - 2 * max(t - 40, 0)


def _turns_back(t: int) -> tuple[float, float]:
    return (60.0 + 2 * t if t < 23 else 106.0 - 2 * max(t - 45, 0)), 70.0


def _passes(t: int) -> tuple[float, float]:
    return 60.0 + 2 * t, 78.0


def _slides_past(t: int) -> tuple[float, float]:
    return 104.0, 20 + 1.6 * t


def _passes_nearer(t: int) -> tuple[float, float]:
    return 60.0 + 2 * t, 74.0


def _passes_farther(t: int) -> tuple[float, float]:
    return 60.0 + 2 * t, 80.0


@pytest.mark.parametrize('pale', [50, 60])
@pytest.mark.parametrize('way', [
    _comes_and_goes, _turns_back, _passes_nearer, _passes, _passes_farther, _slides_past])
def test_one_that_rests_keeps_its_name_when_a_larger_one_touches_it(
    way: Callable[[int], tuple[float, float]], pale: int,
) -> None:
    v, u = np.mgrid[:140, :240]
    rng = np.random.default_rng(1)

    def picture(t: int) -> np.ndarray:
        light = 150 + rng.normal(0, 1.5, u.shape)
        for x, y, radius, contrast in ((120.0, 70.0, 5, 70), (*way(t), 10, pale)):
            light -= contrast / (1 + np.exp(np.hypot(u - x, v - y) - radius))
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)

    settings, _ = teacher.like(TrackerSettings(), picture(0), 120.0, 70.0)
    tracker = Tracker(settings)
    poses = [tracker.update(picture(t), t / 10) for t in range(80)]
    before, after = (dict(zip(now.id.tolist(), now.xy.tolist(), strict=True))
                     for now in (poses[5], poses[-1]))
    resting = min(before, key=lambda name: math.dist(before[name], (120, 70)))
    assert math.dist(after[resting], (120, 70)) < 0.5


def test_what_is_said_of_many_is_one_sentence() -> None:
    said = [f'particle {name} may be two: so it is' for name in range(60)]
    assert together(['it is dark', *said]) == {
        'it is dark': [0],
        'each of the particles 0, 1, 2, 3, 4 and 55 more may be two: so it is': [*range(1, 61)]}
    assert list(together(said[7:8])) == said[7:8]
    remarks = Remarks()
    for frame in range(9):
        remarks.add(frame, {f'doubt {k}': said[k] for k in range(frame)})
    assert remarks.sentences() == [
        'frame 1: each of the particles 0, 1, 2, 3, 4 and 3 more may be two: so it is; '
        '8 frames like it']


@pytest.mark.parametrize('seed', range(4))
def test_two_that_go_on_in_one_outline_keep_the_name_of_the_older(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = np.full((160, 3, 2), 300.0)
    path[:, 0, 0] -= np.maximum(60 - np.arange(160), 0) + 8.0
    path[:, 1, 0] += np.maximum(60 - np.arange(160), 0) + 8.0
    # Together they rest, then roll off another way, and look more like the younger.
    path[:, 2, 1] += np.cumsum(np.clip(np.arange(160) - 100, 0, 8) * 0.75)
    there = np.zeros((160, 3), bool)
    there[:62, 0], there[10:62, 1], there[62:, 2] = True, True, True
    linker = _linker(merging=True)
    names = _follow(linker, path, there, np.array([5.0, 11.0, 12.0]), rng)
    assert names[61][:2] == [0, 1]
    assert {name[2] for name in names[62:]} == {0}
