"""Speed, slip and turning at plateaus, on motion that is known."""

import numpy as np
import pytest
from laboratories import rolling_recording

from microbot_ros.common.records import Commands, Session, SpeedWindow
from microbot_ros.response.plateaus import respond


def test_speed_slip_and_turning_are_those_of_the_motion():
    found = respond(rolling_recording(), 'frequency', 'motion')
    assert found.delay == pytest.approx(0.1, abs=0.03)
    assert [one.level for one in found.plateaus] == [1, 2, 5]
    for one in found.plateaus:
        true = 3e-6 * one.level
        assert one.speed.value == pytest.approx(true * np.cos(0.1), abs=4 * one.speed.std)
        assert one.slip.value == pytest.approx(0.1, abs=4 * one.slip.std)
        assert one.turning.low < 0 < one.turning.high
        assert one.visits == 2
        assert one.left_out > 0


def test_intervals_hold_the_truth_as_often_as_they_say():
    inside, total = 0, 0
    for seed in range(60):
        for one in respond(rolling_recording(seed=seed), 'frequency', 'motion').plateaus:
            true = 3e-6 * one.level * np.exp(0.1j)
            inside += one.speed.low < true.real < one.speed.high
            inside += one.across.low < true.imag < one.across.high
            total += 2
    assert 0.91 <= inside / total <= 0.995


def test_frames_after_a_change_would_slow_everything_down():
    late = rolling_recording(delay=0.25, seconds=3.0)
    motion = respond(late, 'frequency', 'motion').plateaus
    tables = respond(late, 'frequency', 'tables').plateaus
    for one, other in zip(motion, tables, strict=True):
        assert one.speed.value == pytest.approx(3e-6 * one.level * np.cos(0.1),
                                                abs=4 * one.speed.std)
        if one.level > 1:
            assert other.speed.value < 0.8 * one.speed.value


@pytest.mark.parametrize('base', ['elapsed', 'last_interval', 'frames'])
def test_the_tables_own_definition_to_the_last_digit(base):
    made = rolling_recording(robots=2)
    session = Session(made.tracks, made.commands, made.conditions, 'made',
                      speed_window=SpeedWindow(7, base))
    for one in respond(session, 'frequency', 'tables').plateaus:
        own = session.tracks.of(one.particle)
        z = own.position @ [1, 1j]
        speed = [abs(z[k] - z[k - 7]) / {'elapsed': own.t[k] - own.t[k - 7],
                                         'last_interval': 7 * (own.t[k] - own.t[k - 1]),
                                         'frames': 7}[base]
                 for k in range(7, len(z)) if session.commands.frequency_at(own.t[k]) == one.level]
        assert one.speed.value == pytest.approx(np.mean(speed), rel=1e-9)
        assert one.frames == len(speed)
        assert np.isnan(one.slip.value)


def test_a_direction_that_always_turns_is_modelled_and_said():
    turning = rolling_recording(np.repeat([1.0, 3.0], 60), seconds=0.2, delay=0.0, slip=0.2,
                        alpha=lambda t: 2.0 * t)
    found = respond(turning, 'frequency', 'motion')
    assert any('turns nearly all the time' in note for note in found.notes)
    for one in found.plateaus:
        size = np.hypot(one.speed.value, one.across.value)
        assert size == pytest.approx(3e-6 * one.level, rel=0.05)


def test_small_turns_end_no_plateau_whatever_the_rounding_of_the_field():
    """The size of a field is that of its components, to the last digit but one."""
    session = rolling_recording(np.repeat([1.0, 2.0, 4.0], 20), seconds=0.2, delay=0.0, slip=0.0,
                                alpha=lambda t: np.radians(10 * t))
    assert len(np.unique(np.hypot(*session.commands.field.T))) > 1
    found = respond(session, 'frequency', 'motion')
    assert [(one.level, one.visits) for one in found.plateaus] == [(1, 1), (2, 1), (4, 1)]
    for one in found.plateaus:
        assert one.frames > 80  # of 100
        assert one.speed.value == pytest.approx(3e-6 * one.level, abs=4 * one.speed.std)


def test_what_else_was_commanded_is_held():
    tilt = np.array([np.pi / 2, np.pi / 2, np.pi / 2, 0.0, np.pi / 2, np.pi / 2])
    session = rolling_recording(tilt=tilt)
    found = respond(session, 'frequency', 'motion')
    assert {one.level: one.visits for one in found.plateaus} == {1.0: 2, 2.0: 1, 5.0: 2}
    assert found.notes == ['3.0 s left out, in which the axis is not 90 ° from the vertical']
    against = respond(session, 'tilt', 'motion')
    assert len({one.level for one in against.plateaus}) <= 2
    assert 'in which the rotation is not' in against.notes[0]


def test_swimmers_against_the_strength_of_their_field():
    session = rolling_recording(frequency=False)
    found = respond(session, 'field', 'motion')
    assert [one.level for one in found.plateaus] == pytest.approx([1e-3, 2e-3, 5e-3])
    assert respond(session, 'frequency', 'motion').plateaus == []


def test_leaps_and_gaps_are_no_motion():
    session = rolling_recording()
    session.tracks.position[40:] += 4e-4
    keep = np.ones(len(session.tracks.t), bool)
    keep[200:230] = False
    tracks = session.tracks.rows(keep)
    for one in respond(Session(tracks, session.commands, name='made'), 'frequency',
                       'motion').plateaus:
        assert one.speed.value == pytest.approx(3e-6 * one.level * np.cos(0.1), rel=0.12)


@pytest.mark.parametrize('rows', [1, 2, 3])
def test_almost_nothing_is_no_crash(rows):
    session = rolling_recording()
    tracks = session.tracks.rows(slice(rows))
    for definition in ('motion', 'tables'):
        found = respond(Session(tracks, session.commands, name='short'), 'frequency', definition)
        assert all(one.frames <= rows for one in found.plateaus)
    none = Session(tracks, Commands(np.empty(0), np.empty((0, 2))))
    assert respond(none, 'frequency', 'motion').notes == ['nothing was commanded']
