"""Linking by itself: turns of the field, vibrations, and what the filter makes of them."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.tracking import Appearance, Drive, TrackerSettings
from microbot_ros.tracking.link.global_motion import common_displacement, common_shake
from microbot_ros.tracking.link.linker import Linker
from microbot_ros.tracking.link.states import planar
from microbot_ros.tracking.locate.detect import Detections

_SIDE = 300
_DIAMETER = 10.0


def _linker() -> Linker:
    looks = Appearance(
        table=np.zeros((1, 9)), reach_px=8.0, diameter_px=_DIAMETER, contrast_grey=60.0,
        min_contrast_grey=20.0, round=True)
    return Linker(TrackerSettings(), looks, (_SIDE, _SIDE))


def _seen(places: np.ndarray, rng: np.random.Generator) -> Detections:
    """Places (N, 2) as detections, in an order that says nothing."""
    order = rng.permutation(len(places))
    one = np.ones(len(places))
    return Detections(
        xy=places[order] + rng.normal(0, 0.1, places.shape), sigma=0.1 * one,
        theta=np.nan * one, contrast=60 * one, radius=5 * one, quality=one,
        kind=np.zeros(len(places), int))


def _names(linker: Linker, places: np.ndarray) -> np.ndarray:
    """The identity nearest each place, −1 where none is within 3 px."""
    away = np.linalg.norm(places[:, None] - linker.states.xy, axis=2)
    return np.where(away.min(axis=1) < 3, linker.states.id[away.argmin(axis=1)], -1)


def _swim(driven: bool, seed: int) -> int:
    """Identity switches of swimmers at 5 frames/s whose field turns every second or so."""
    rng = np.random.default_rng(seed)
    count, dt, substeps = 12, 0.2, 20
    velocity_phasor = rng.uniform(15, 40, count) * np.exp(1j * rng.uniform(-np.pi, np.pi, count))
    place = rng.uniform(60, _SIDE - 60, count) + 1j * rng.uniform(60, _SIDE - 60, count)
    linker, drive = _linker(), Drive()
    field, turns_at, switches = 1 + 0j, 0.0, 0
    last = np.full(count, -1)
    for frame in range(150):
        for k in range(substeps):
            t = (frame + k / substeps) * dt
            if t >= turns_at:
                # Back to where it came from and on: the swarm stays in view.
                field *= cmath.exp(1j * rng.uniform(0.6, 1.4) * math.pi)
                turns_at = t + rng.uniform(0.6, 1.6)
                drive.command(t, np.array([field.real, field.imag]))
            place = place + velocity_phasor * field * dt / substeps
        place = place + rng.normal(0, 0.3, count) + 1j * rng.normal(0, 0.3, count)
        if frame:
            pushed = complex(*drive.between(frame * dt, (frame + 1) * dt))
            linker.predict(dt, pushed if driven else 0j)
        linker.update(_seen(planar(place), rng))
        names = _names(linker, planar(place))
        known = (names >= 0) & (last >= 0)
        switches += int(np.sum(names[known] != last[known]))
        last = np.where(names >= 0, names, last)
    return switches


def test_a_turn_of_the_field_keeps_identities_that_constant_velocity_loses() -> None:
    with_drive = sum(_swim(True, seed) for seed in range(3))
    without = sum(_swim(False, seed) for seed in range(3))
    assert without > 100
    assert with_drive < 0.05 * without


def test_speed_and_angle_of_each_particle_are_learned_and_predict_a_turn() -> None:
    rng = np.random.default_rng(2)
    velocity_phasor = np.array([30 * cmath.exp(0.5j), 20 * cmath.exp(-2j), 12 + 0j])
    place = np.array([80 + 80j, 200 + 90j, 120 + 210j])
    linker = _linker()
    for frame in range(120):
        push = cmath.exp(1j * (frame // 10) * 2.2) / 10
        place = place + velocity_phasor * push
        if frame:
            linker.predict(0.1, push)
        linker.update(_seen(planar(place), rng))
    rows = np.argsort(np.abs(linker.states.motion[:, 0][:, None] - place).argmin(axis=1))
    np.testing.assert_allclose(linker.states.motion[rows, 2], velocity_phasor, atol=1.0)
    turned = linker.states.velocity(-1j)[rows]
    np.testing.assert_allclose(turned, planar(-1j * velocity_phasor), atol=2.5)


def test_slow_swimmers_at_a_high_rate_are_not_lost_to_what_the_field_might_do() -> None:
    """The first drive covers a hundredth of a frame, the frames come unevenly."""
    rng = np.random.default_rng(6)
    place = np.array([80 + 80j, 200 + 90j, 120 + 210j, 220 + 220j])
    velocity_phasor = 9 * np.exp(1j * rng.uniform(-np.pi, np.pi, 4))
    linker, angle = _linker(), 0.0
    for frame in range(900):
        dt = (1 + rng.poisson(0.5)) / 60
        if frame % 30 == 0:
            angle = rng.uniform(-np.pi, np.pi)
        push = cmath.exp(1j * angle) * (dt if frame > 20 else dt / 100 if frame == 20 else 0)
        noise = rng.normal(0, 0.05, 4) + 1j * rng.normal(0, 0.05, 4)
        place = place + velocity_phasor * push + noise
        if frame:
            linker.predict(dt, push)
        linker.update(_seen(planar(place), rng))
    assert sorted(_names(linker, planar(place))) == [0, 1, 2, 3]
    assert len(linker.states) == 4
    rows = np.argsort(np.abs(linker.states.motion[:, 0][:, None] - place).argmin(axis=1))
    np.testing.assert_allclose(linker.states.motion[rows, 2], velocity_phasor, atol=3.0)
    covariance = linker.states.covariance
    np.testing.assert_allclose(covariance, covariance.conj().swapaxes(1, 2), rtol=1e-9, atol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > 0


@pytest.mark.parametrize('size', [1.5, 4.0])
def test_vibration_beyond_a_diameter_keeps_identities_and_velocities(size: float) -> None:
    rng = np.random.default_rng(3)
    place = rng.uniform(80, _SIDE - 80, (15, 2))
    velocity = rng.normal(0, 6.0, place.shape)
    linker, last = _linker(), np.full(15, -1)
    switches = told = 0
    for frame in range(200):
        shaken = np.zeros(2)
        if frame % 10 == 9:
            angle = rng.uniform(-np.pi, np.pi)
            shaken = size * _DIAMETER * np.array([math.cos(angle), math.sin(angle)])
        velocity = np.where(np.abs(place - _SIDE / 2) > 100, -velocity, velocity)
        place = place + velocity / 30
        if frame:
            linker.predict(1 / 30, 0j)
        linker.update(_seen(place + shaken, rng))
        told += linker.jump > 0.5 * _DIAMETER
        names = _names(linker, place + shaken)
        known = (names >= 0) & (last >= 0)
        switches += int(np.sum(names[known] != last[known]))
        last = np.where(names >= 0, names, last)
    assert switches <= 2
    assert 35 <= told <= 40  # there and back, twenty times
    assert np.abs(linker.states.velocity(0j)).max() < 60


def test_a_picture_that_moves_on_is_motion_not_vibration() -> None:
    rng = np.random.default_rng(4)
    place = rng.uniform(40, 160, (12, 2))
    linker = _linker()
    for frame in range(20):
        if frame >= 8:
            place = place + np.array([7.0, 0.0])
        if frame:
            linker.predict(0.1, 0j)
        linker.update(_seen(place, rng))
    assert set(_names(linker, place)) == set(range(12))
    np.testing.assert_allclose(
        np.median(linker.states.velocity(0j), axis=0), [70, 0], atol=5)


def test_few_particles_or_new_ones_are_no_jump() -> None:
    rng = np.random.default_rng(5)
    here = rng.uniform(0, _SIDE, (30, 2))
    size = (_SIDE, _SIDE)
    assert common_displacement(here[:2], here[:2] + 20, 5.0, size) is None
    assert common_displacement(here, np.empty((0, 2)), 5.0, size) is None
    assert common_displacement(here, here, 5.0, size) is None
    assert common_displacement(here, here[:18], 5.0, size) is None
    others = sum(
        common_displacement(here[:10], rng.uniform(0, _SIDE, (10, 2)), 5.0, size) is not None
        for _ in range(200))
    assert others == 0
    found = np.vstack([here[:24] + np.array([31.0, -18.0]), rng.uniform(0, _SIDE, (15, 2))])
    np.testing.assert_allclose(common_displacement(here, found, 5.0, size), [31, -18], atol=1e-9)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0, 10), st.floats(-5, 5), st.floats(-5, 5)), max_size=8),
       st.floats(0, 4), st.floats(0, 4), st.floats(0, 4))
def test_the_drive_is_an_integral(
    rows: list[tuple[float, float, float]], start: float, first: float, second: float
) -> None:
    one, two, whole = Drive(), Drive(), Drive()
    rows = sorted(rows)
    for drive in (one, two, whole):
        for t, x, y in rows:
            drive.command(t, np.array([x, y]))
    parts = one.between(start, start + first) + two.between(start + first, start + first + second)
    times = [t for t, _, _ in rows]
    fine = np.linspace(start, start + first + second, 4001)
    middle = (fine[1:] + fine[:-1]) / 2
    held = np.array([[0.0, 0.0], *([x, y] for _, x, y in rows)])[
        np.searchsorted(times, middle, side='right')]
    np.testing.assert_allclose(whole.between(start, start + first + second), parts, atol=1e-9)
    np.testing.assert_allclose(parts, held.mean(axis=0) * (first + second), atol=0.05)


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_a_drive_takes_finite_commands_only_and_starts_again_when_time_does(bad: float) -> None:
    drive = Drive()
    drive.command(1.0, np.array([1.0, 0.0]))
    drive.command(2.0, np.array([bad, 0.0]))
    drive.command(2.0, np.array([0.0, bad]))
    drive.command(bad, np.array([0.0, 9.0]))
    np.testing.assert_allclose(drive.between(0.0, 3.0), [2, 0])
    drive.command(0.5, np.array([0.0, 1.0]))
    np.testing.assert_allclose(drive.between(0.0, 3.0), [0, 2.5])


def _shaken(amplitude: float, seed: int) -> int:
    """Identity switches of a dense swarm in a picture that trembles, 5.3 frames to a turn."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(40, _SIDE - 40, (25, 2))
    velocity = rng.normal(0, 6.0, place.shape)
    linker, last, switches = _linker(), np.full(25, -1), 0
    for frame in range(200):
        beyond = np.abs(place - _SIDE / 2) > 120
        velocity = np.where(beyond, -np.sign(place - _SIDE / 2) * np.abs(velocity), velocity)
        place = place + velocity / 30 + rng.normal(0, 0.2, place.shape)
        turn = math.tau * frame / 5.3
        seen = place + amplitude * np.array([math.sin(turn), math.cos(turn)])
        if frame:
            linker.predict(1 / 30, 0j)
        linker.update(_seen(seen, rng))
        assert linker.jump == 0
        names = _names(linker, seen)
        known = (names >= 0) & (last >= 0)
        switches += int(np.sum(names[known] != last[known]))
        last = np.where(names >= 0, names, last)
    return switches


def test_a_picture_that_trembles_in_every_frame_costs_no_identities(
        monkeypatch: pytest.MonkeyPatch) -> None:
    assert sum(_shaken(2.0, seed) for seed in range(4)) == 0
    monkeypatch.setattr('microbot_ros.tracking.link.linker.common_shake', lambda *_: None)
    assert sum(_shaken(2.0, seed) for seed in range(4)) > 0


def test_few_particles_or_ways_of_their_own_are_no_shaking() -> None:
    rng = np.random.default_rng(8)
    here = rng.uniform(20, _SIDE - 20, (20, 2))
    assert common_shake(here[:4], here[:4] + 3, 10.0, 1.5) is None
    assert common_shake(here, np.empty((0, 2)), 10.0, 1.5) is None
    assert common_shake(here, here + rng.normal(0, 4.0, here.shape), 10.0, 1.5) is None
    found = np.vstack([here[:16] + np.array([3.0, -2.0]), rng.uniform(0, _SIDE, (10, 2))])
    np.testing.assert_allclose(common_shake(here, found, 10.0, 1.5), [3, -2], atol=1e-9)
