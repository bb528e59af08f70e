"""A particle that a wall holds has no speed and says why; one that swims freely is never held."""

from unittest import mock

import numpy as np
import pytest

from microbot_ros.common.records import Conditions
from microbot_ros.estimation import held as held_module
from microbot_ros.estimation.held import LOOK, HeldWatch, _legs, is_held
from microbot_ros.estimation.online.estimator import Estimator
from microbot_ros.estimation.swimming import Swimming

RATE, FIELD = 30.0, 5e-3
DIFFUSION, READ = 0.2e-12, 5e-8
SPEED, PHI = 4.1e-6, 0.4


def swim(seconds, direction, *, wall=None, floor=None, start=(0.0, 0.0), flow=(0.0, 0.0),
         driven=np.inf, slower=None, seed=0):
    """Answers (t, speed [m/s], sentences) of the estimator for one particle, frame by frame.

    The command points to `direction(t)` [rad], until `driven` [s]: from then on there is none, and
    the heading stays. The speed is `slower(t)` times SPEED. Nothing passes x = `wall` [m] and
    y = `floor` [m].
    """
    random = np.random.default_rng(seed)
    estimator, told = Estimator(), []
    place = np.array(start, float)
    for frame in range(int(seconds * RATE)):
        t = frame / RATE
        angle = direction(min(t, driven))
        estimator.command(t, (t < driven) * FIELD * np.array([np.cos(angle), np.sin(angle)]))
        found = estimator.update(
            t, np.array([7]), (place + random.normal(0, READ, 2))[None], np.full(1, READ))
        told.append((t, float(found.speed[0]), found.diagnosis))
        assert (7 in found.unknown_because) == ('particle 7: held' in ''.join(found.diagnosis))
        heading = angle + PHI
        speed = SPEED * (slower(t) if slower else 1.0)
        place = place + (speed * np.array([np.cos(heading), np.sin(heading)]) + flow) / RATE
        place += random.normal(0, np.sqrt(2 * DIFFUSION / RATE), 2)
        if wall is not None:
            place[0] = min(place[0], wall)
        if floor is not None:
            place[1] = max(place[1], floor)
    return told


def pressing(t):
    """Into the wall at x > 0, in directions that change, and never away from it."""
    return -PHI + 1.0 * np.sin(1.9 * t)


def every_way(t):
    return 0.9 * t


def around(t):
    """There and back, so that it stays about where it is."""
    return np.pi * (int(t / 2) % 2) + 0.3 * t


def slowly(t):
    return 0.1 * t


def held(told):
    return [t for t, _, said in told if any('held by a wall' in one for one in said)]


SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2))]


@pytest.mark.parametrize('seed', SEEDS)
def test_what_a_wall_holds_has_no_speed_and_says_why(seed):
    told = swim(20.0, pressing, wall=1e-6, seed=seed)
    times = held(told)
    assert 0 < times[0] < 12
    assert all(np.isnan(speed) for t, speed, _ in told if t > times[0] + 0.1)
    assert 'particle 7: held by a wall or the edge of the image' in told[-1][2][0]


@pytest.mark.parametrize('seed', SEEDS)
def test_it_is_known_again_once_it_swims_freely(seed):
    told = swim(34.0, lambda t: pressing(t) if t < 12 else np.pi - PHI + pressing(t), wall=1e-6,
                seed=seed)
    assert held(told)[-1] < 26
    assert told[-1][1] == pytest.approx(SPEED, rel=0.1)


@pytest.mark.parametrize('flow', [(0.0, 0.0), (1e-6, -1e-6)])
@pytest.mark.parametrize('direction', [every_way, around, pressing, slowly])
@pytest.mark.parametrize('seed', SEEDS)
def test_who_swims_freely_is_never_held(direction, flow, seed):
    told = swim(40.0, direction, flow=flow, seed=seed)
    assert held(told) == []
    assert np.isfinite(told[-1][1])


@pytest.mark.parametrize('spread', [0.0, 0.1])
def test_who_is_kept_in_place_by_readings_that_err_is_never_held(spread):
    """Each command leads back to 0 along x from where the particle seems to be.

    The error of a reading at the edge goes with the step after it, and one direction of command
    hardly tells c.
    """
    for seed in range(300):
        random = np.random.default_rng(seed)
        place, read, swum = 0j, [], []
        for _ in range(121):
            read.append(place + 3e-7 * complex(*random.normal(size=2)))
            angle = np.pi * (read[-1].real > 0) + spread * random.normal()
            swum.append(0.1 * np.exp(1j * angle))
            place += SPEED * swum[-1] + 9e-8 * complex(*random.normal(size=2))
        z, swum = np.array(read), np.array(swum[:-1])
        assert not is_held(z[:-1], np.diff(z), swum, _legs(np.angle(swum)))


@pytest.mark.parametrize('seed', SEEDS)
def test_what_drifts_to_the_edge_without_a_field_keeps_its_speed(seed):
    """As after STOP: the field goes, the particle swims on, the edge of the picture stops it."""
    told = swim(40.0, every_way, wall=15e-6, start=(-5e-6, 0.0), driven=10.0, seed=seed)
    before = next(speed for t, speed, _ in told if t >= 10.0)
    assert before == pytest.approx(SPEED, rel=0.1)
    later = np.array([speed for t, speed, _ in told if t > 10.0])
    assert later[np.isfinite(later)] == pytest.approx(before, rel=0.02)


@pytest.mark.parametrize('seed', SEEDS)
def test_without_a_field_nothing_is_held(seed):
    """Headings diffuse then, so that a particle stays about where it is."""
    random = np.random.default_rng(seed)
    estimator = Estimator(Conditions(radius=1e-6, viscosity=1e-3))
    place, heading, rate = 0j, 0.0, 20
    for frame in range(80 * rate):
        if frame % 40 == 0 or frame == 40 * rate:
            heading = frame // 40 * 1.1
            strength = FIELD if frame < 40 * rate else 0.0
            estimator.command(
                frame / rate, strength * np.array([np.cos(heading), np.sin(heading)]))
        if frame >= 40 * rate:
            heading += np.sqrt(2 * 0.164 / rate) * random.normal()
        seen = place + READ * complex(*random.normal(size=2))
        found = estimator.update(
            frame / rate, np.array([7]), np.array([[seen.real, seen.imag]]), np.full(1, READ))
        assert 'held' not in ''.join(found.diagnosis)
        place += SPEED * np.exp(1j * heading) / rate + np.sqrt(
            2 * DIFFUSION / rate) * complex(*random.normal(size=2))


@pytest.mark.parametrize('seed', SEEDS)
def test_what_one_command_presses_to_a_wall_has_no_speed_and_says_why(seed):
    told = swim(40.0, lambda t: 0.9 * t if t < 8 else -PHI, wall=15e-6, start=(-5e-6, 0.0),
                seed=seed)
    times = held(told)
    assert 8 < times[0] < 20
    assert all(np.isnan(speed) for t, speed, _ in told if t > times[0] + 0.1)


@pytest.mark.parametrize('seed', SEEDS)
def test_it_is_known_again_once_another_command_leads_it_away(seed):
    told = swim(50.0, lambda t: 0.9 * t if t < 8 else -PHI if t < 25 else np.pi - PHI + 0.4 * t,
                wall=15e-6, start=(-5e-6, 0.0), seed=seed)
    assert held(told)[0] < 20 < 25 < held(told)[-1] < 32
    assert told[-1][1] == pytest.approx(SPEED, rel=0.15)


@pytest.mark.parametrize(('angle', 'turn'), [(0.6, 0.0), (-0.6, 0.03), (-0.3, 0.03)])
@pytest.mark.parametrize('seed', SEEDS)
def test_what_slides_along_a_wall_has_no_speed_and_says_why(angle, turn, seed):
    """Under a command that turns slowly or not at all, at an `angle` to the wall's normal."""
    told = swim(30.0, lambda t: 0.9 * t if t < 14 else angle + turn * (t - 14) - PHI, wall=12e-6,
                start=(-3e-6, 0.0), seed=seed)
    times = held(told)
    assert 14 < times[0] < 26
    assert all(np.isnan(speed) for t, speed, _ in told if t > times[0] + 0.1)


@pytest.mark.parametrize('seed', SEEDS)
def test_what_slides_into_a_corner_and_on_is_held_until_it_leaves(seed):
    """Along one edge of the image, into its corner, along the next, and away."""
    told = swim(100.0, lambda t: 0.9 * t if t < 14 else 0.6 - 0.05 * (t - 14) - PHI, wall=12e-6,
                floor=-20e-6, start=(-3e-6, 0.0), seed=seed)
    times = held(told)
    assert 14 < times[0] < 26
    assert times == [t for t, *_ in told if times[0] <= t <= times[-1]]
    # It leads away from 88.8 s on; 35° from the edge, before, both explain the motion.
    assert 76 < times[-1] < 95


@pytest.mark.parametrize('seed', SEEDS)
@pytest.mark.parametrize('slower', [
    lambda t: np.exp(-t / 120), lambda t: 1.0 if t < 30 else 0.6])
def test_who_becomes_slower_is_not_held(slower, seed):
    told = swim(60.0, lambda t: 2.1 * (t // 3), slower=slower, seed=seed)
    assert held(told) == []


def test_a_roller_that_steps_out_is_not_held():
    """Beyond its step-out frequency it stands, wherever it is."""
    random, place, told = np.random.default_rng(3), np.zeros(2), []
    estimator = Estimator(Conditions('rolling'))
    for frame in range(int(30 * RATE)):
        t = frame / RATE
        frequency = 5.0 if t < 15 else 20.0
        estimator.command(t, FIELD * np.array([np.cos(0.9 * t), np.sin(0.9 * t)]), frequency)
        found = estimator.update(
            t, np.array([7]), (place + random.normal(0, READ, 2))[None], np.full(1, READ))
        told.append((t, float(found.speed[0]), found.diagnosis))
        speed = 2e-6 * frequency if frequency < 10 else 0.0
        place = place + speed / RATE * np.array([np.cos(0.9 * t + PHI), np.sin(0.9 * t + PHI)])
        place += random.normal(0, np.sqrt(2 * DIFFUSION / RATE), 2)
    assert held(told) == []


def test_how_it_swims_is_not_known_from_one_command_few_steps_or_noise():
    ways = 0.1 * np.exp(0.1j * np.arange(100))
    assert Swimming.of(SPEED * ways, ways).c == pytest.approx(SPEED)
    assert Swimming.of(SPEED * ways[:50], ways[:50]) is None
    assert Swimming.of(SPEED * np.full(100, 0.1 + 0j), np.full(100, 0.1 + 0j)) is None
    assert Swimming.of(np.zeros(100, complex), np.zeros(100, complex)) is None
    noise = np.random.default_rng(0).normal(0, 3e-6, (2, 100))
    assert Swimming.of(SPEED * ways + noise[0] + 1j * noise[1], ways) is None


@pytest.mark.parametrize('flow', [0, 0.05e-6 - 0.02e-6j])
def test_a_wall_takes_the_part_of_the_motion_into_it(flow):
    ways = 0.1 * np.exp(0.05j * np.arange(100))
    known = Swimming.of(SPEED * ways + flow, ways)
    steps = SPEED * ways[:30] + flow
    assert not known.is_blocked(steps, ways[:30], 0.0)
    for wall in np.exp(1j * np.array([0.8, 2.0, -1.0])):
        slides = (steps / wall).real * wall
        assert known.is_blocked(slides, ways[:30], 10.0)
    for other in (0.5, 0.9j, -1, 2):  # slower, turned, both, faster
        assert not known.is_blocked(other * SPEED * ways[:30] + flow, ways[:30], 0.0)


def test_a_particle_is_looked_at_three_times_a_second():
    """A look takes as long as a filter step, and a wall is found after seconds."""
    watch, ids = HeldWatch(), np.array([3, 7])
    with mock.patch.object(held_module, 'is_held', return_value=False) as look:
        for frame in range(119):
            watch.add(frame / 100, ids, np.zeros(2, complex), np.ones(2, bool), {})
    assert look.call_count == len(ids) * round(1.2 / LOOK)
