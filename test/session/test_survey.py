"""What `microbot info` tells: counted by hand here."""


import numpy as np
import pytest
from recordings import encode, header, record, small_session

from microbot_ros.common.records import Commands, Session
from microbot_ros.session import write_session
from microbot_ros.session.mcap.bag import typestore
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.replay.as_messages import SessionMessages
from microbot_ros.session.survey import (
    command_spread,
    missing_frames,
    survey_folder,
    survey_recording,
)

TIME_REFERENCE = 'sensor_msgs/msg/TimeReference'


def circle(*degrees: float, magnitude: float = 2e-3) -> Commands:
    """One second in each direction."""
    angle = np.radians(degrees)
    field = magnitude * np.column_stack([np.cos(angle), np.sin(angle)])
    return Commands(np.arange(len(degrees), dtype=float), field)


def test_even_directions_have_circular_variance_one_and_one_direction_zero():
    assert command_spread(circle(0, 90, 180, 270), 0, 4).direction_variance == pytest.approx(1)
    assert command_spread(circle(40, 40), 0, 2).direction_variance == pytest.approx(0)
    # Two at right angles: the resultant is cos 45°.
    assert command_spread(circle(0, 90), 0, 2).direction_variance == pytest.approx(1 - 0.5**0.5)


def test_directions_are_weighted_by_the_time_they_are_held():
    spread = command_spread(circle(0, 180), 0.5, 1.5)
    assert spread.direction_variance == pytest.approx(1)
    assert command_spread(circle(0, 180), 0.5, 1.0).direction_variance == pytest.approx(0)
    # The last row holds on: 1 s at 0° against 3 s at 180°.
    assert command_spread(circle(0, 180), 0, 4).direction_variance == pytest.approx(0.5)


def test_levels_turns_and_rest_are_counted():
    field = np.array([[1, 0], [0, 1], [0, 0], [0, 2.0], [1.999, 0], [0, -2]]) * 1e-3
    spread = command_spread(Commands(np.arange(6.0), field), 0, 6)
    assert spread.magnitudes_mT == (1, 2)
    assert (spread.turns_left, spread.turns_right) == (1, 2)
    assert spread.off_share == pytest.approx(1 / 6)
    assert spread.rows == 6


def test_a_rolling_field_that_does_not_turn_is_off():
    commands = circle(0, 90, 180)
    rolling = Commands(commands.t, commands.field, np.array([0.0, 5, 10]))
    spread = command_spread(rolling, 0, 3)
    assert spread.frequencies_hz == (5, 10)
    assert spread.off_share == pytest.approx(1 / 3)


def test_a_negative_frequency_is_the_opposite_direction():
    commands = circle(0, 0, 90, 90)
    rolling = Commands(commands.t, commands.field, np.array([5.0, -5, -5, 5]))
    spread = command_spread(rolling, 0, 4)
    # 0°, 180°, 270°, 90°: half a turn is to either side.
    assert spread.direction_variance == pytest.approx(1)
    assert spread.turns_left + spread.turns_right == 3
    assert spread.frequencies_hz == (-5, 5)


def test_missing_frames_are_the_holes_in_an_even_rate():
    times = np.arange(20) / 60 + np.random.default_rng(0).normal(0, 1e-3, 20)
    assert missing_frames(times) == 0
    assert missing_frames(np.delete(times, [3, 4, 9])) == 3
    assert missing_frames(times[:1]) == 0


def test_a_folder_and_its_recording_tell_the_same(tmp_path):
    session = small_session()
    write_session(tmp_path / 'csv', session)
    folder, _ = survey_folder(tmp_path / 'csv')
    with Recording(record(tmp_path / 'run', session)) as recording:
        recorded, _ = survey_recording(recording)
    assert [t.count for t in folder.topics] == [t.count for t in recorded.topics]
    for a, b in zip(folder.topics, recorded.topics, strict=True):
        assert a.rate_hz == pytest.approx(b.rate_hz)
    assert folder.excitation.direction_variance == pytest.approx(
        recorded.excitation.direction_variance)
    assert folder.excitation.magnitudes_mT == recorded.excitation.magnitudes_mT
    assert (folder.frames, folder.particles) == (recorded.frames, 2)
    assert folder.kind == 'folder'
    assert recorded.metadata['session']['radius_um'] == '2.5'


def test_gaps_latency_and_what_was_dropped_are_told(tmp_path):
    times = [*range(1, 11), *range(31, 41)]
    make = typestore().types['builtin_interfaces/msg/Time']
    with RecordingWriter(tmp_path / 'run') as writer:
        for i in times:
            exposure = make(0, i * 1_000_000)
            data = encode(TIME_REFERENCE, header((i + 12) * 1_000_000), exposure, 'camera')
            writer.write('/coil_driver/latency', TIME_REFERENCE, (i + 12) * 1_000_000, data)
        writer.attach('rig.yaml', '')
        writer.describe('dropped', {'/markers': '7'})
    with Recording(tmp_path / 'run') as recording:
        found, session = survey_recording(recording)
    assert session is None
    assert 'particles' in found.remarks[0]
    assert found.latency_ms == pytest.approx({'p50': 12, 'p99': 12})
    topic, = found.topics
    assert (topic.count, topic.gaps, topic.longest_gap_s) == (20, 1, pytest.approx(0.021))
    assert topic.rate_hz == pytest.approx(19 / 0.039)
    assert found.dropped == {'/markers': 7}
    assert found.attachments == ('rig.yaml',)


def test_commands_that_start_late_are_remarked_on(tmp_path):
    session = small_session()
    late = Commands(session.commands.t + 0.5, session.commands.field)
    write_session(tmp_path / 'csv', Session(session.tracks, late))
    found, _ = survey_folder(tmp_path / 'csv')
    assert any('first 0.5 s' in remark for remark in found.remarks)


def test_messages_of_a_session_start_at_one_second():
    assert SessionMessages(small_session()).start_ns == 1_000_000_000
