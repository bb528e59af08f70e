"""The tracker against the Cramér–Rao bound, against trackpy, and against time."""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from bench._tracker_endurance import memory
from bench._tracker_scenes import crowd, identity_switches, light, scene
from bench._tracker_worlds import LEARNING, World, world
from bench.figure import Figure, seconds
from microbot_ros.cameras.source import open_source
from microbot_ros.tracking import Tracker, TrackerSettings, learn
from microbot_ros.tracking.locate.detect import RoundDetector
from microbot_ros.tracking.locate.outline import OutlineDetector
from microbot_ros.tracking.tracker import make_detector

_DATA = Path(__file__).parents[1].parent / 'shared' / 'data'
_NOWHERE = np.empty((0, 2))

_LIKE_TRACKPY = TrackerSettings(
    diameter_px=8, min_contrast_grey=2, min_quality=0, size_tolerance=2.4, min_detection_sigma=4)
"""Settings that accept the dim and blurred spheres of `bulk_water` that trackpy accepts too."""


def figures() -> Iterator[Figure]:
    """All figures of the tracker; those of real recordings only where these are."""
    cv2.setNumThreads(1)
    yield from _precision()
    yield from _worlds()
    yield from _crossings()
    yield _noise()
    yield memory()
    if _DATA.is_dir():
        yield from _bulk_water()
        yield from _mickyroll()


def _precision() -> list[Figure]:
    found = []
    spreads, biases, recalls, precisions, against_trackpy = [], [], [], [], []
    for snr in (5, 10, 20, 40):
        ratios = []
        for kind, sign in (('spot', 1), ('spot', -1), ('disc', -1), ('ring', -1)):
            contrast = sign * (50 if snr == 5 else 60)
            error, sigma, theirs, bound, counts = _errors(kind, contrast, snr)
            rms = np.sqrt(np.mean(error**2))
            ratios.append(rms / bound)
            spreads.append(np.sqrt(np.mean(sigma**2)) / rms)
            biases.append(np.max(np.abs(error.mean(axis=0))))
            against_trackpy.append(rms / np.sqrt(np.mean(theirs**2)))
            if snr >= 10:
                recalls.append(counts[0] / counts[2])
                precisions.append(counts[0] / counts[1])
        worst = max(ratios)
        found.append(Figure(8, f'position error at SNR {snr}', worst, '× the bound', '≤ 1.15',
                            'Cramér–Rao bound', worst <= 1.15))
    deviation = max(spreads, key=lambda ratio: abs(np.log(ratio)))
    return [
        *found,
        _at_most(8, 'bias of the position', max(biases), 'px', 0.02, 'truth'),
        _at_most(8, 'position error, worst of all', max(against_trackpy), '× trackpy', 1.0,
                 'trackpy.locate'),
        _at_least(8, 'recall at SNR ≥ 10', min(recalls), '', 0.99, 'truth'),
        _at_least(8, 'precision at SNR ≥ 10', min(precisions), '', 0.99, 'truth'),
        Figure(8, 'published σ, worst', deviation, '× actual', '0.9–1.1', 'actual error',
               0.9 <= deviation <= 1.1),
    ]


def _errors(
    kind: str, contrast: float, snr: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, tuple[int, int, int]]:
    """Our errors (K, 2), σ (K,), trackpy's errors, the bound; matched, found, true counts."""
    import trackpy

    trackpy.quiet()
    pictures = scene(kind, contrast, snr, seed=3)
    settings = TrackerSettings()
    appearance = learn(pictures.frames, settings)
    if appearance is None:
        raise RuntimeError(f'nothing learned from {kind} at SNR {snr}')
    detector = make_detector(appearance, settings)
    tree = cKDTree(pictures.truth)
    error, sigma, theirs, counts = [], [], [], np.zeros(3, int)
    for frame in pictures.frames:
        found = detector.detect(frame, _NOWHERE)
        away, which = tree.query(found.xy)
        near = away < 3
        error.append((found.xy - pictures.truth[which])[near])
        sigma.append(found.sigma[near])
        counts += [len(set(which[near])), len(found), len(pictures.truth)]
    for frame in pictures.frames:
        table = trackpy.locate(frame, {'spot': 9, 'disc': 13, 'ring': 15}[kind],
                               invert=contrast < 0, engine='numba', topn=len(pictures.truth))
        places = table[['x', 'y']].to_numpy()
        away, which = tree.query(places)
        theirs.append((places - pictures.truth[which])[away < 3])
    return (np.concatenate(error), np.concatenate(sigma), np.concatenate(theirs), pictures.bound,
            (int(counts[0]), int(counts[1]), int(counts[2])))


def _worlds(count: int = 20) -> list[Figure]:
    """Random microscopes, from the first frame on: is the right thing learned and measured?"""
    recalls, precisions, biases, spreads = [], [], [], []
    for seed in range(count):
        seen = world(seed, 20)
        settings = TrackerSettings(cap='bright' if seen.bright else 'dark')
        appearance = learn(seen.frames[:LEARNING], settings)
        if appearance is None:
            raise RuntimeError(f'nothing learned from microscope {seed}')
        error, sigma, found = _errors_by_cap(seen, make_detector(appearance, settings))
        recalls.append(len(error) / sum(map(len, seen.places[LEARNING:])))
        precisions.append(len(error) / max(found, 1))
        if appearance.capped:
            biases.append(abs(np.mean(error[:, 0])))
        spreads.append(np.sqrt(np.mean(sigma**2) / np.mean(error**2)))
    spread = float(np.median(spreads))
    return [
        _at_least(8, f'recall, worst of {count} microscopes', min(recalls), '', 0.99, 'truth'),
        _at_least(8, f'precision, worst of {count} microscopes', min(precisions), '', 0.99,
                  'truth'),
        _at_most(8, f'bias along the cap, mean of these (worst {max(biases):.3f})',
                 float(np.mean(biases)), 'px', 0.02, 'truth'),
        Figure(8, f'published σ, median of these ({min(spreads):.2f} to {max(spreads):.2f})',
               spread, '× actual', '0.9–1.1', 'actual error', 0.9 <= spread <= 1.1),
    ]


def _errors_by_cap(
    seen: World, detector: RoundDetector | OutlineDetector
) -> tuple[np.ndarray, np.ndarray, int]:
    """Errors (K, 2) along and across the cap [px], σ (K,), and how many were found in all."""
    errors, sigmas, count = [], [], 0
    views = list(zip(seen.frames, seen.places, seen.caps, strict=True))[LEARNING:]
    for frame, places, caps in views:
        found = detector.detect(frame, _NOWHERE)
        count += len(found)
        if len(found) == 0:
            continue
        away, nearest = cKDTree(found.xy).query(places)
        near = away < 0.6 * seen.radius_px
        error, angle = (found.xy[nearest] - places)[near], caps[near]
        cos, sin = np.cos(angle), np.sin(angle)
        errors.append(np.column_stack([
            error[:, 0] * cos + error[:, 1] * sin, error[:, 1] * cos - error[:, 0] * sin]))
        sigmas.append(found.sigma[nearest][near])
    return np.concatenate(errors), np.concatenate(sigmas), count


def _crossings() -> list[Figure]:
    import pandas as pd
    import trackpy

    warnings.simplefilter('ignore')
    trackpy.quiet()
    people = crowd(5500, seed=11)
    settings = TrackerSettings()
    tracker = Tracker(settings, learn(people.frames[:10], settings))
    ours = []
    for t, frame in enumerate(people.frames):
        poses = tracker.update(frame, t / 60)
        ours.append((poses.id[poses.seen], poses.xy[poses.seen]))
    located = pd.concat([
        trackpy.locate(frame, 13, invert=True, minmass=800, engine='numba').assign(frame=t)
        for t, frame in enumerate(people.frames)])
    theirs = []
    for reach in (5, 7, 9):
        predictor = trackpy.predict.NearestVelocityPredict()
        linked = predictor.link_df(located.copy(), reach, memory=15)
        groups = dict(list(linked.groupby('frame')))
        seen = [
            (groups[t]['particle'].to_numpy(), groups[t][['x', 'y']].to_numpy())
            if t in groups else (np.empty(0, int), _NOWHERE) for t in range(len(people.frames))]
        theirs.append(identity_switches(people, seen))
    mine, best = identity_switches(people, ours), min(theirs)
    return [
        _at_least(8, 'crossings in the rendered crowd', people.crossings(), '', 2000, ''),
        _at_most(8, f'identity switches ({mine} against {best})', mine / best, '× trackpy', 0.2,
                 'trackpy, NearestVelocityPredict, best of three ranges'),
    ]


def _noise(frames: int = 10_000) -> Figure:
    """Tracks on noise alone, by a tracker that looks for small spots five times the noise."""
    rng = np.random.default_rng(5)
    pictures = scene('spot', 50, 5, seed=6, frames=4)
    settings = TrackerSettings()
    tracker = Tracker(settings, learn(pictures.frames, settings))
    bank = rng.normal(0, 10, (1 << 22)).astype(np.float32)
    lamp = light(240, 320).astype(np.float32)
    names: set[int] = set()
    for t in range(frames):
        start = rng.integers(0, len(bank) - lamp.size)
        frame = np.rint(lamp + bank[start:start + lamp.size].reshape(lamp.shape))
        names.update(tracker.update(frame.astype(np.uint8), t / 60).id.tolist())
    return _at_most(8, f'false tracks in {frames} frames of noise, 320×240', len(names), '', 0, '')


def _bulk_water() -> list[Figure]:
    import trackpy

    trackpy.quiet()
    frames = list(open_source(_DATA / 'bulk_water', print, 24.0).frames())
    image = frames[0].image
    appearance = learn([frame.image for frame in frames[:10]], _LIKE_TRACKPY)
    assert appearance is not None
    detector = make_detector(appearance, _LIKE_TRACKPY)
    ours, theirs = seconds(
        lambda: detector.detect(image, _NOWHERE),
        lambda: trackpy.locate(image, 11, invert=True, minmass=100, engine='numba'), rounds=21)
    table = trackpy.locate(image, 11, invert=True, minmass=100, engine='numba')
    away, _ = cKDTree(detector.detect(image, _NOWHERE).xy).query(table[['x', 'y']].to_numpy())
    diffusion, peer = _diffusion(_own_tracks(frames)), _diffusion(_trackpy_tracks(frames))
    return [
        _at_least(8, f'detection of {len(table)} spheres, 640×424', theirs / ours, '× faster',
                  15, "trackpy.locate(engine='numba')"),
        _at_least(8, 'of the same spheres', float(np.mean(away < 2)), '', 0.95, 'trackpy.locate'),
        Figure(8, 'D of bulk_water', diffusion, 'µm²/s', '0.35–0.50',
               f'Stokes–Einstein 0.43, trackpy {peer:.2f}', 0.35 <= diffusion <= 0.50),
    ]


_Tracks = dict[int, dict[int, np.ndarray]]
"""Particle → frame → place (2,) [µm]."""


def _own_tracks(frames: list) -> _Tracks:  # type: ignore[type-arg]
    settings = TrackerSettings()
    tracker = Tracker(settings, learn([frame.image for frame in frames[:10]], settings))
    tracks: _Tracks = {}
    for frame in frames:
        poses = tracker.update(frame.image, frame.t)
        for name, place, seen in zip(poses.id, poses.xy, poses.seen, strict=True):
            if seen:
                tracks.setdefault(int(name), {})[frame.index] = place / 2.85
    return tracks


def _trackpy_tracks(frames: list) -> _Tracks:  # type: ignore[type-arg]
    import trackpy

    tables = [trackpy.locate(frame.image, 11, invert=True, minmass=100, engine='numba')
              .assign(frame=frame.index) for frame in frames]
    tracks: _Tracks = {}
    for table in trackpy.link_df_iter(tables, 5, memory=3):
        for t, name, x, y in table[['frame', 'particle', 'x', 'y']].to_numpy():
            tracks.setdefault(int(name), {})[int(t)] = np.array([x, y]) / 2.85
    return tracks


def _diffusion(tracks: _Tracks) -> float:
    """Half the slope of the mean squared displacement per axis over half a second, drift off."""
    lags = np.arange(1, 13)
    squares = []
    for lag in lags:
        steps = {
            (t, name): track[t + lag] - track[t]
            for name, track in tracks.items() if len(track) >= 25
            for t in track if t + lag in track}
        drift = {t: np.mean([d for (s, _), d in steps.items() if s == t], axis=0)
                 for t in {t for t, _ in steps}}
        squares.append(np.mean([np.mean((d - drift[t]) ** 2) for (t, _), d in steps.items()]))
    return float(np.polyfit(lags / 24, squares, 1)[0] / 2)


def _mickyroll() -> list[Figure]:
    source = open_source(_DATA / 'mickyroll1.mp4', print)
    images = [frame.image for frame in itertools.islice(source.frames(), 120)]
    settings = TrackerSettings()
    appearance = learn(images[:10], settings)
    tracker = Tracker(settings, appearance)
    spent = np.array([_seconds(tracker, image, t / 60) for t, image in enumerate(images)])[10:]
    return [_at_least(8, 'detection and linking, 2048×1080', 1 / float(np.median(spent)),
                      'frames/s', 60, 'one core')]


def _seconds(tracker: Tracker, image: np.ndarray, t: float) -> float:
    start = time.perf_counter()
    tracker.update(image, t)
    return time.perf_counter() - start


def _at_most(issue: int, name: str, value: float, unit: str, bound: float, peer: str) -> Figure:
    return Figure(issue, name, float(value), unit, f'≤ {bound:g}', peer, bool(value <= bound))


def _at_least(issue: int, name: str, value: float, unit: str, bound: float, peer: str) -> Figure:
    return Figure(issue, name, float(value), unit, f'≥ {bound:g}', peer, bool(value >= bound))
