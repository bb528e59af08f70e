"""The tracker over time: identities through crossings and gaps, bad frames, stamps, noise."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from bench._tracker_scenes import crowd, expose, identity_switches, light, scene
from microbot_ros.tracking import FrameError, Tracker, TrackerSettings, learn
from microbot_ros.tracking.link.assign import assign
from microbot_ros.tracking.link.motion import Motion
from microbot_ros.tracking.refine.appearance import Appearance

ROUND = TrackerSettings(shape='round')


@pytest.fixture(scope='module')
def still() -> list[np.ndarray]:
    return [frame[:240, :320] for frame in scene('disc', -60, 15, seed=9, frames=6).frames]


@pytest.fixture(scope='module')
def appearance(still: list[np.ndarray]) -> Appearance:
    learned = learn(still, ROUND)
    assert learned is not None
    return learned


@pytest.fixture
def tracker(appearance: Appearance) -> Tracker:
    return Tracker(ROUND, appearance)


def test_crossings_and_gaps_keep_identities() -> None:
    people = crowd(400, seed=3)
    tracker = Tracker(ROUND, learn(people.frames[:10], ROUND))
    seen = []
    for t, frame in enumerate(people.frames):
        poses = tracker.update(frame, t / 60)
        seen.append((poses.id[poses.seen], poses.xy[poses.seen]))
    assert people.crossings() > 100
    assert identity_switches(people, seen) <= 0.15 * people.crossings()
    named = set(itertools.chain.from_iterable(names.tolist() for names, _ in seen))
    assert len(named) <= 30


def test_an_unseen_particle_is_carried_on_with_growing_doubt(
    still: list[np.ndarray], tracker: Tracker
) -> None:
    for t in range(6):
        before = tracker.update(still[t], float(t))
    assert before.seen.all()
    empty = expose(light(480, 640)[:240, :320], 4, np.random.default_rng(0))
    doubts = []
    for t in range(6, 6 + tracker.settings.coast_frames):
        poses = tracker.update(empty, float(t))
        assert poses.id.tolist() == before.id.tolist()
        assert not poses.seen.any()
        doubts.append(poses.sigma_px[0])
    assert np.all(np.diff(doubts) > 0)
    assert len(tracker.update(empty, 99.0)) == 0
    for t in range(100, 104):
        poses = tracker.update(still[t % 6], float(t))
    assert set(poses.id).isdisjoint(before.id)
    assert len(poses) == len(before)


def test_without_an_appearance_it_learns_one_first(still: list[np.ndarray]) -> None:
    tracker = Tracker(TrackerSettings(shape='round', learning_frames=3))
    counts = [len(tracker.update(still[t % 6], t / 60)) for t in range(90)]
    assert counts[0] == 0
    assert tracker.ready
    assert counts[-1] == counts[-2] > 10


@pytest.mark.parametrize('frame', [
    np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320)), np.zeros((100, 320), np.uint8),
    np.zeros((240, 320), np.uint16), np.zeros((0, 320), np.uint8)])
def test_a_frame_of_another_kind_is_refused_and_changes_nothing(
    frame: np.ndarray, still: list[np.ndarray], tracker: Tracker
) -> None:
    for t in range(4):
        before = tracker.update(still[t], float(t))
    with pytest.raises(FrameError, match='expected'):
        tracker.update(frame, 4.0)
    assert tracker.update(still[4], 4.0).id.tolist() == before.id.tolist()


@pytest.mark.parametrize('stamp', [3.0, 2.5, math.nan, math.inf, -math.inf])
def test_a_time_that_is_not_later_is_refused(
    stamp: float, still: list[np.ndarray], tracker: Tracker
) -> None:
    for t in range(4):
        before = tracker.update(still[t], float(t))
    with pytest.raises(FrameError, match='time stamp'):
        tracker.update(still[4], stamp)
    assert tracker.update(still[4], 4.0).id.tolist() == before.id.tolist()


def test_a_clock_set_back_for_good_is_followed(still: list[np.ndarray], tracker: Tracker) -> None:
    for t in range(4):
        before = tracker.update(still[t], 100.0 + t)
    with pytest.raises(FrameError, match='before the last one'):
        tracker.update(still[4], 1.0)
    assert tracker.update(still[5], 2.0).id.tolist() == before.id.tolist()
    assert tracker.update(still[4], 3.0).seen.all()


@pytest.mark.parametrize('drive', [[math.nan, 0.0], [math.inf, 0.0], [1.0], 3.0])
def test_a_drive_is_two_finite_numbers(
    drive: object, still: list[np.ndarray], tracker: Tracker
) -> None:
    with pytest.raises(FrameError, match='finite field'):
        tracker.update(still[0], 0.0, np.array(drive))


def test_a_jump_of_the_picture_keeps_identities_and_is_told(tracker: Tracker) -> None:
    """Somebody touches the table: all move by two diameters at once."""
    whole = scene('disc', -60, 15, seed=9, frames=6).frames
    jump = np.array([20.0, 14.0])
    for t in range(4):
        before = tracker.update(whole[t][:240, :320], t / 60)
    assert tracker.remarks == {}
    poses = tracker.update(whole[4][14:254, 20:340], 4 / 60)
    old = {int(name): place for name, place in zip(before.id, before.xy, strict=True)}
    kept = [(old[int(n)], p) for n, p in zip(poses.id, poses.xy, strict=True) if int(n) in old]
    assert len(kept) > 20
    np.testing.assert_allclose([p - o for o, p in kept], np.tile(-jump, (len(kept), 1)), atol=1)
    assert tracker.remarks == {'jump': 'the image jumped by 24 px'}
    assert np.abs(poses.velocity[poses.seen]).max() < 100


def test_noise_and_a_flickering_lamp_invent_nothing(tracker: Tracker) -> None:
    rng = np.random.default_rng(4)
    lamp = light(480, 640)[:240, :320]
    for t in range(300):
        flicker = 1 + 0.3 * math.sin(t)
        assert len(tracker.update(expose(lamp * flicker, 4, rng), t / 60)) == 0


def test_a_flickering_lamp_loses_nobody(still: list[np.ndarray], tracker: Tracker) -> None:
    names = set()
    for t in range(60):
        dimmed = (still[t % 6] * (0.85 + 0.1 * math.sin(t))).astype(np.uint8)
        poses = tracker.update(dimmed, t / 60)
        names.update(poses.id.tolist())
    assert len(names) == len(poses)
    assert poses.seen.all()


def test_a_lamp_that_fades_loses_nobody_and_is_told(
    still: list[np.ndarray], tracker: Tracker
) -> None:
    names: set[int] = set()
    for t in range(150):
        faded = (still[t % 6] * (1 - 0.5 * t / 150)).astype(np.uint8)
        poses = tracker.update(faded, t / 60)
        names.update(poses.id.tolist())
    assert len(names) == len(poses) > 20
    assert poses.seen.all()
    assert list(tracker.remarks) == ['drift']


def test_assignment_is_the_best_of_all() -> None:
    """Against every permutation, for five particles among five detections."""
    rng = np.random.default_rng(5)
    ones, looks = np.ones(5), np.zeros((5, 1))
    for _ in range(20):
        there, found = rng.uniform(0, 6, (5, 2)), rng.uniform(0, 6, (5, 2))
        pairs = assign(
            there, ones, 100 * ones, looks, 0 * ones, found, ones, looks, 1.0, 1e-12)
        square = np.sum((there[:, None] - found) ** 2, axis=2)
        cost = 5 * np.log(1 + square / 16)
        best = min(sum(cost[i, p[i]] for i in range(5)) for p in itertools.permutations(range(5)))
        assert len(pairs.track) == 5
        assert sum(cost[pairs.track, pairs.detection]) == pytest.approx(best)


def test_the_motion_of_swimmers_and_of_brownian_spheres_is_learned() -> None:
    rng = np.random.default_rng(1)
    for speed, jitter, sigma in ((3.0, 0.5, 0.2), (0.0, 1.0, 0.1)):
        velocity = rng.normal(0, speed, (500, 1, 2))
        path = np.cumsum(velocity + rng.normal(0, jitter, (500, 20, 2)), axis=1)
        steps = np.diff(path + rng.normal(0, sigma, path.shape), axis=1)
        motion = Motion(20.0)
        for t in range(1, 19):
            motion.learn(steps[:, t], steps[:, t - 1], np.full(500, sigma))
        assert motion.velocity_step == pytest.approx(speed**2, rel=0.15, abs=0.1)
        assert motion.random_step == pytest.approx(jitter**2, rel=0.3, abs=0.35)


@pytest.mark.parametrize('shape', [(12, 300), (20, 20), (300, 12)])
def test_small_pictures_have_no_particles(shape: tuple[int, int]) -> None:
    tracker, random = Tracker(TrackerSettings(learning_frames=3)), np.random.default_rng(0)
    for k in range(12):
        found = tracker.update(random.normal(150, 1, shape).astype(np.uint8), 0.1 * k)
        assert len(found) == 0


@pytest.mark.parametrize('shape', [(1, 100), (11, 300), (300, 4)])
def test_pictures_that_are_too_small_are_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(FrameError, match='at least 12×12 pixels'):
        Tracker(TrackerSettings()).update(np.full(shape, 150, np.uint8), 0.0)


def test_a_first_frame_that_is_refused_sets_no_size(still: list[np.ndarray]) -> None:
    tracker = Tracker(ROUND)
    with pytest.raises(FrameError, match='finite time stamp'):
        tracker.update(np.full((100, 100), 150, np.uint8), math.nan)
    tracker.update(still[0], 0.0)
    assert tracker.size == still[0].shape
