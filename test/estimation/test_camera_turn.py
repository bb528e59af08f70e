"""Handedness and rotation of the camera, from swimmers of the virtual rig seen by a turned one."""

from dataclasses import replace

import numpy as np
import pytest
from filmed import FIELD, swimmers

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands
from microbot_ros.estimation.camera_turn import _common, _mean, camera_turn
from microbot_ros.tracking import ImageToWorkspace
from microbot_ros.virtual_rig.record_session import Camera

PIXELS = {'pixel_size': 0.5e-6, 'width': 640, 'height': 480}


def swim(seed, phi, commands=None):
    """A session of one swimmer for each φ, under commands that turn."""
    return swimmers(seed, 20.0, Camera(20.0, 0.0, 0.1e-6, 0.05), phi=phi, spacing=60e-6,
                    dwell=(1.0, 3.0), commands=commands)[0]


def seen_through(session, camera, believed):
    """The session as somebody records it who takes the camera for another."""
    pixels = camera.pixels(session.tracks.position)
    return replace(session, tracks=replace(session.tracks, position=believed.position(pixels)))


@pytest.mark.parametrize('mirrored', [False, True])
@pytest.mark.parametrize('believed', [(0.0, False), (-0.7, True), (2.0, False)])
def test_any_belief_is_put_right(mirrored, believed):
    camera = ImageToWorkspace(**PIXELS, rotation=0.4, mirrored=mirrored)
    other = ImageToWorkspace(**PIXELS, rotation=believed[0], mirrored=believed[1])
    session = seen_through(swim(1, np.zeros(3)), camera, other)
    turn = camera_turn(session, phi=0.0)
    rotation, now_mirrored = turn.corrected(*believed)
    assert now_mirrored == mirrored
    assert turn.mirrored == (mirrored != believed[1])
    assert turn.known
    assert abs(np.angle(np.exp(1j * (rotation - 0.4)))) < 1.5 * turn.interval
    assert turn.interval < 0.1


def test_phi_is_zero_on_average_or_stated():
    phi = np.array([0.3, -0.2, 0.1, -0.3, 0.25, -0.15])
    plain = ImageToWorkspace(**PIXELS)
    session = seen_through(swim(2, phi), ImageToWorkspace(**PIXELS, rotation=-1.0), plain)
    average = camera_turn(session)
    assert average.known
    assert average.corrected(0.0, False)[0] == pytest.approx(-1.0, abs=average.interval)
    assert 0.15 < average.interval < 0.5  # what six φ of spread 0.25 leave open
    one = camera_turn(seen_through(
        swim(3, [0.8]), ImageToWorkspace(**PIXELS, rotation=-1.0), plain), phi=0.8)
    assert one.corrected(0.0, False)[0] == pytest.approx(-1.0, abs=1.5 * one.interval)


def test_particles_without_a_direction_in_common_leave_the_rotation_as_it_is():
    for phi in (np.array([0.5]), np.arange(5) * 2 * np.pi / 5):
        turn = camera_turn(swim(4, phi))
        assert not turn.known
        assert not turn.mirrored
        assert turn.corrected(0.3, True) == (pytest.approx(0.3), True)


def test_commands_along_one_line_do_not_show_the_handedness():
    times = np.arange(0, 20, 2.0)
    field = FIELD * np.array([[1.0, 0.0], [-1.0, 0.0]])[np.arange(10) % 2]
    with pytest.raises(InputError, match='three directions'):
        camera_turn(swim(5, np.zeros(3), Commands(times, field)))


def test_particles_that_do_not_answer_are_refused():
    session = swim(6, np.zeros(2))
    rng = np.random.default_rng(0)
    walk = rng.normal(0, 1e-7, session.tracks.position.shape)
    still = replace(session, tracks=replace(session.tracks, position=np.cumsum(walk, axis=0)))
    with pytest.raises(InputError, match='expected'):
        camera_turn(still)


def test_intervals_hold_what_they_promise():
    rng = np.random.default_rng(7)
    trials = 400
    for spread, count in ((0.3, 4), (0.6, 12)):
        held = 0
        for _ in range(trials):
            turn, interval = _mean(rng.normal(0, spread, count))
            held += abs(turn) < interval
        assert 0.91 < held / trials < 0.98
    held = 0
    for _ in range(trials):
        std = rng.uniform(0.02, 0.2, 8)
        turn, interval = _common(rng.normal(0, std), std)
        held += abs(turn) < interval
    assert 0.92 < held / trials < 0.99
