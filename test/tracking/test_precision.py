"""Detection against truth that is drawn finer than the pixels, and the Cramér–Rao bound."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from bench._tracker_scenes import KINDS, draw, expose, light, scene
from microbot_ros.tracking import TrackerSettings, learn
from microbot_ros.tracking.tracker import make_detector
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

NOWHERE = np.empty((0, 2))


@pytest.mark.parametrize(('kind', 'contrast', 'snr'), [
    ('spot', 60, 10), ('disc', -60, 10), ('ring', -60, 20), ('disc', -60, 40)])
def test_positions_reach_the_bound_and_say_so(kind: str, contrast: float, snr: float) -> None:
    pictures = scene(kind, contrast, snr, seed=4, frames=4)
    appearance = learn(pictures.frames, TrackerSettings())
    assert appearance is not None
    assert appearance.round
    assert not appearance.capped
    detector = make_detector(appearance, TrackerSettings())
    error, sigma = [], []
    for frame in pictures.frames:
        found = detector.detect(frame, NOWHERE)
        away, which = cKDTree(pictures.truth).query(found.xy)
        assert len(found) == len(pictures.truth) == len(set(which))
        assert away.max() < 1
        error.append(found.xy - pictures.truth[which])
        sigma.append(found.sigma)
    rms = np.sqrt(np.mean(np.concatenate(error) ** 2))
    assert 0.9 < rms / pictures.bound < 1.15
    assert np.abs(np.concatenate(error).mean(axis=0)).max() < 0.02
    assert 0.9 < np.sqrt(np.mean(np.concatenate(sigma) ** 2)) / rms < 1.1


@pytest.mark.parametrize('absorption', [0.0, 0.75])
def test_the_edge_of_the_picture_pulls_at_nobody(absorption: float) -> None:
    scope = Microscope(MicroscopeSettings(cap_absorption=absorption), 1)
    rng = np.random.default_rng(2)
    width, height = scope.settings.width_px, scope.settings.height_px

    def picture(places: np.ndarray) -> np.ndarray:
        across = places - (np.array([width, height]) - 1) / 2
        metres = across * [1, -1] * scope.settings.pixel_size
        np.testing.assert_allclose(scope.pixels(metres), places, atol=1e-6)
        return scope.render(metres, rng.uniform(-3, 3, len(places)), 0.0)

    inside = np.stack(np.meshgrid([100.0, 300, 500], [100.0, 250, 400]), axis=-1).reshape(-1, 2)
    appearance = learn([picture(inside + rng.normal(0, 0.7, inside.shape)) for _ in range(12)],
                       TrackerSettings())
    assert appearance is not None
    assert appearance.capped == (absorption > 0)
    detector, off, told = make_detector(appearance, TrackerSettings()), [], []
    for away in np.linspace(3.5, 9, 45).tolist():
        along = rng.uniform(-1, 1, (4, 2)) + 200
        places = np.array([(away, along[0, 0]), (width - 1 - away, along[1, 0]),
                           (along[2, 0], away), (along[3, 0], height - 1 - away)])
        found = detector.detect(picture(places), NOWHERE)
        inward = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
        distance, which = cKDTree(places).query(found.xy)
        assert distance.max(initial=0.0) < 1
        off.append(np.sum((found.xy - places[which]) * inward[which], axis=1))
        told.append(found.sigma)
    z = np.concatenate(off) / np.concatenate(told)
    assert len(z) > 100
    assert abs(np.mean(np.concatenate(off))) < 0.005
    assert np.sqrt(np.mean(z**2)) < 1.2


def _frames(particles: np.ndarray, rng: np.random.Generator, **debris: bool) -> list[np.ndarray]:
    """Four frames of 10 px discs, with what else lies about."""
    picture = light(240, 320)
    for place in particles:
        draw(picture, place, KINDS['disc'], -60)
    if debris.get('specks'):
        for place in rng.uniform(5, [315, 235], (60, 2)):
            draw(picture, place, lambda r: np.exp(-(r**2) / 1.5), -40)
    if debris.get('blurred'):
        for place in rng.uniform(20, [300, 220], (8, 2)):
            draw(picture, place, lambda r: np.exp(-(r**2) / 100), -30)
    if debris.get('hair'):
        y, x = np.mgrid[0:240, 0:320]
        picture -= 50 * np.exp(-((y - 0.4 * x - 30 - 8 * np.sin(x / 30)) ** 2) / 4)
    return [expose(picture, 4, rng) for _ in range(4)]


@pytest.mark.parametrize('debris', ['specks', 'blurred', 'hair'])
def test_debris_is_left_alone(debris: str) -> None:
    rng = np.random.default_rng(8)
    particles = np.array([[60.0, 170.3], [150.2, 200.1], [250.7, 70.4], [200.5, 30.0]])
    clean = _frames(particles, rng)
    settings = TrackerSettings(shape='round')
    appearance = learn(clean, settings)
    assert appearance is not None
    detector = make_detector(appearance, settings)
    for frame in _frames(particles, rng, **{debris: True}):
        found = detector.detect(frame, NOWHERE)
        away, which = cKDTree(particles).query(found.xy)
        assert len(set(which)) == 4
        assert np.sum(away > 3) <= (1 if debris == 'hair' else 0)


def test_touching_particles_are_told_apart_when_expected() -> None:
    rng = np.random.default_rng(2)
    lone = np.array([[60.0, 60.0], [200.0, 100.0], [120.0, 180.0]])
    settings = TrackerSettings(shape='round')
    appearance = learn(_frames(lone, rng), settings)
    assert appearance is not None
    detector = make_detector(appearance, settings)
    pair = np.array([[150.3, 120.2], [155.8, 122.1]])
    frame = _frames(pair, rng)[0]
    found = detector.detect(frame, pair + rng.normal(0, 0.8, pair.shape))
    assert len(found) == 2
    away, _ = cKDTree(found.xy).query(pair)
    assert away.max() < 0.4


def test_an_expected_particle_that_is_not_there_is_not_found() -> None:
    rng = np.random.default_rng(2)
    lone = np.array([[60.0, 60.0], [200.0, 100.0]])
    frames = _frames(lone, rng)
    appearance = learn(frames, TrackerSettings(shape='round'))
    assert appearance is not None
    detector = make_detector(appearance, TrackerSettings(shape='round'))
    found = detector.detect(frames[0], np.vstack([lone, lone[:1] + np.array([9.0, 3.0])]))
    away, _ = cKDTree(lone).query(found.xy)
    assert len(found) == 2
    assert away.max() < 0.3


@pytest.mark.parametrize('frame', [
    np.zeros((240, 320), np.uint8), np.full((240, 320), 255, np.uint8),
    np.random.default_rng(0).integers(0, 256, (240, 320)).astype(np.uint8)])
def test_nothing_is_found_where_nothing_is(frame: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    settings = TrackerSettings(shape='round')
    appearance = learn(_frames(np.array([[60.0, 60.0], [200.0, 100.0]]), rng), settings)
    assert appearance is not None
    assert len(make_detector(appearance, settings).detect(frame, NOWHERE)) == 0
    assert learn([frame] * 3, TrackerSettings()) is None


def test_thousands_of_specks_are_told_of_and_are_no_particles() -> None:
    rng = np.random.default_rng(11)
    lone = np.array([[60.0, 60.0], [200.0, 100.0], [120.0, 180.0]])
    settings = TrackerSettings(shape='round')
    appearance = learn(_frames(lone, rng), settings)
    assert appearance is not None
    detector = make_detector(appearance, settings)
    assert len(detector.detect(_frames(lone, rng)[0], NOWHERE)) == 3
    assert detector.remark == ''
    picture = light(240, 320)
    for place in rng.uniform(2, [318, 238], (2000, 2)):
        draw(picture, place, lambda r: np.exp(-(r**2) / 1.5), -40)
    assert len(detector.detect(expose(picture, 4, rng), NOWHERE)) == 0
    assert 'not a particle' in detector.remark
