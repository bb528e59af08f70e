"""Which topics become tracks and commands, and what is refused."""

import numpy as np
import pytest
from recordings import VECTOR, encode, header, record, small_session, vector

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Session
from microbot_ros.session import read_session
from microbot_ros.session.mcap.bag import typestore
from microbot_ros.session.mcap.recorder import RecordingWriter

CLOUD = 'sensor_msgs/msg/PointCloud2'
JOINTS = 'sensor_msgs/msg/JointState'
TWIST = 'geometry_msgs/msg/TwistStamped'
MAGNETIC = 'sensor_msgs/msg/MagneticField'
MS = 1_000_000
START = 1_700_000_000_000_000_000


def cloud(stamp_ns: int, rows: list[tuple], names=('id', 'x', 'y'), code=8, big=False) -> bytes:
    """A cloud of float64 (code 8) or float32 (7) fields."""
    kind = {7: 'f4', 8: 'f8'}[code]
    size = int(kind[1])
    make = typestore().types['sensor_msgs/msg/PointField']
    fields = [make(name, size * i, code, 1) for i, name in enumerate(names)]
    data = np.array(rows, ('>' if big else '<') + kind).tobytes()
    step = size * len(names)
    return encode(CLOUD, header(stamp_ns), 1, len(rows), fields, big, step, step * len(rows),
                  np.frombuffer(data, np.uint8), True)


def joints(*effort: float) -> bytes:
    return encode(JOINTS, header(0), [], np.empty(0), np.empty(0), np.array(effort))


def write(folder, *messages, metadata=None):
    """A recording of (ms since the start, topic, type, data)."""
    with RecordingWriter(folder) as writer:
        for key, entries in (metadata or {}).items():
            writer.describe(key, entries)
        for ms, topic, kind, data in messages:
            writer.write(topic, kind, START + ms * MS, data)
    return folder


def particles(ms: int, *rows: tuple, **options):
    """Received 4 ms after exposure."""
    return ms + 4, '/particles', CLOUD, cloud(START + ms * MS, list(rows), **options)


def command(ms: int, x: float, y: float):
    return ms, '/field/command', VECTOR, vector(START, x, y)


def rotating(ms: int, field: tuple[float, float], rate: tuple[float, float]):
    types = typestore().types
    make = types['geometry_msgs/msg/Vector3']
    twist = types['geometry_msgs/msg/Twist'](make(*field, 0.0), make(*rate, 0.0))
    return ms, '/field/rotating', TWIST, encode(TWIST, header(START), twist)


FRAMES = [particles(ms, (0, ms * 1e-6, 2e-6), (7, 1e-6, -1e-6)) for ms in (0, 10, 20)]


@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize('code', [7, 8])
def test_tracks_are_at_the_time_of_exposure_whatever_the_layout(tmp_path, code, big):
    names = ('sigma', 'y', 'vx', 'id', 'x', 'theta')
    rows = [(1e-7, 3e-6, 9, 5, 2e-6, 0.5), (2e-7, 4e-6, 9, 1, 6e-6, np.nan)]
    frame = particles(10, *rows, names=names, code=code, big=big)
    tracks = read_session(write(tmp_path / 'run', command(0, 0, 0), frame)).tracks
    np.testing.assert_allclose(tracks.t, [0.01, 0.01])
    assert tracks.particle.tolist() == [1, 5]
    np.testing.assert_allclose(tracks.position, [[6e-6, 4e-6], [2e-6, 3e-6]], rtol=1e-7)
    np.testing.assert_allclose(tracks.theta, [np.nan, 0.5])
    np.testing.assert_allclose(tracks.sigma, [2e-7, 1e-7], rtol=1e-7)


def test_a_position_that_is_no_number_is_a_gap(tmp_path):
    frame = particles(30, (0, np.nan, 0), (7, 1, np.inf), (8, 1, 1))
    tracks = read_session(write(tmp_path / 'run', *FRAMES, frame)).tracks
    assert tracks.particle.tolist() == [0, 7] * 3 + [8]
    assert np.isnan(tracks.sigma).all()


def test_commands_take_force_when_received_and_repeats_are_one_row(tmp_path):
    commands = read_session(write(
        tmp_path / 'run', *FRAMES[:2], command(16, 1e-3, 0), command(17, 1e-3, 0),
        command(18, 0, 2e-3), FRAMES[2])).commands
    np.testing.assert_allclose(commands.t, [0.012, 0.014])
    assert commands.field.tolist() == [[1e-3, 0], [0, 2e-3]]
    assert commands.frequency is None


def test_where_the_gate_lets_nothing_through_the_command_is_zero(tmp_path):
    commands = read_session(write(
        tmp_path / 'run', (0, '/coils/applied', JOINTS, joints(0, 0)), command(1, 1e-3, 0),
        (2, '/coils/applied', JOINTS, joints(0.5, 0)), command(5, 0, 1e-3),
        (8, '/coils/applied', JOINTS, joints(0, 0)), *FRAMES)).commands
    np.testing.assert_allclose(commands.t, [0, 0.002, 0.005, 0.008])
    assert commands.field.tolist() == [[0, 0], [1e-3, 0], [0, 1e-3], [0, 0]]


def test_a_field_rotates_until_the_next_that_stands(tmp_path):
    commands = read_session(write(
        tmp_path / 'run', command(0, 1e-3, 0),
        rotating(2, (0, 2e-3), (-2 * np.pi * 5, 0)),
        command(5, 0, 0), *FRAMES)).commands
    np.testing.assert_allclose(commands.t, [0, 0.002, 0.005])
    np.testing.assert_allclose(commands.frequency, [0, 5, 0])
    assert commands.field.tolist() == [[1e-3, 0], [0, 2e-3], [0, 0]]


@pytest.mark.parametrize(('rate', 'frequency'), [
    ((-5, 0), 5), ((5, 0), -5), ((-3, 4), 5), ((3, -4), -5), ((0, 0), 0)])
def test_a_rotation_that_rolls_against_its_field_has_a_negative_frequency(
        tmp_path, rate, frequency):
    """A sphere on the floor that rotates with ω moves along ω × ẑ; the field is along y."""
    rate = tuple(2 * np.pi * np.array(rate, float))
    commands = read_session(write(
        tmp_path / 'run', rotating(0, (0, 2e-3), rate), *FRAMES)).commands
    np.testing.assert_allclose(commands.frequency, [frequency])
    assert commands.field.tolist() == [[0, 2e-3]]


def test_a_session_that_rolls_back_is_the_same_as_a_recording(tmp_path):
    made = small_session(rolling=True)
    to_and_fro = np.where(np.arange(10) % 2, -1, 1) * made.commands.frequency
    session = Session(made.tracks, Commands(made.commands.t, made.commands.field, to_and_fro),
                      made.conditions)
    commands = read_session(record(tmp_path / 'run', session)).commands
    np.testing.assert_allclose(commands.frequency, to_and_fro)
    np.testing.assert_allclose(commands.field, made.commands.field)


def test_in_earlier_recordings_a_rotation_holds_until_the_next_and_ends_with_the_field(tmp_path):
    rate = 2 * np.pi * 5
    commands = read_session(write(
        tmp_path / 'run', command(0, 1e-3, 0), (2, '/field/rotation', VECTOR, vector(0, 0, rate)),
        command(5, 0, 0), command(9, 0, 1e-3), *FRAMES)).commands
    np.testing.assert_allclose(commands.t, [0, 0.002, 0.005, 0.009])
    np.testing.assert_allclose(commands.frequency, [0, 5, 0, 5])
    assert commands.field.tolist() == [[1e-3, 0], [1e-3, 0], [0, 0], [0, 1e-3]]


def test_without_commands_the_applied_field_stands_in(tmp_path):
    make = typestore().types['geometry_msgs/msg/Vector3']
    field = encode(MAGNETIC, header(0), make(3e-3, 1e-3, 0.0), np.zeros(9))
    applied = (25, '/field/applied', MAGNETIC, field)
    session = read_session(write(tmp_path / 'run', *FRAMES, applied))
    assert session.commands.field.tolist() == [[3e-3, 1e-3]]


def test_without_any_field_there_are_no_commands(tmp_path):
    assert len(read_session(write(tmp_path / 'run', *FRAMES)).commands.t) == 0


def test_conditions_come_from_the_metadata(tmp_path):
    good = {'session': {'propulsion': 'rolling', 'radius_um': '2.5'}}
    conditions = read_session(write(tmp_path / 'a', *FRAMES, metadata=good)).conditions
    assert (conditions.propulsion, conditions.radius) == ('rolling', 2.5e-6)
    bad = {'session': {'radius_um': 'big'}}
    with pytest.raises(InputError, match='radius_um'):
        read_session(write(tmp_path / 'b', *FRAMES, metadata=bad))


@pytest.mark.parametrize(('messages', 'said'), [
    ([command(0, 1, 1)], 'a topic particles'),
    ([particles(0)], 'found none'),
    ([*FRAMES, (25, *particles(15, (0, 1, 1))[1:])], r'stamps to ascend, at 0\.021 s'),
    ([*FRAMES, particles(20, (0, 1, 1))], 'stamps to ascend'),
    ([(0, '/particles', CLOUD, cloud(0, [(0, 1, 1)]))], "on the recorder's clock"),
    ([particles(0, (0, 1, 1), (0, 2, 2))], 'a particle once'),
    ([particles(0, (1, 1), names=('x', 'y'))], 'fields id, x, y'),
    ([*FRAMES, command(40, np.nan, 0)], 'finite'),
    ([*FRAMES, command(40, 0, -np.inf)], 'finite'),
])
def test_bad_topics_are_refused_by_name(tmp_path, messages, said):
    with pytest.raises(InputError, match=said) as refusal:
        read_session(write(tmp_path / 'run', *messages))
    assert refusal.value.source.endswith('run')


def test_a_cloud_shorter_than_its_fields_is_refused(tmp_path):
    make = typestore().types['sensor_msgs/msg/PointField']
    fields = [make(name, 8 * i, 8, 1) for i, name in enumerate(('id', 'x', 'y'))]
    short = encode(CLOUD, header(START), 1, 2, fields, False, 24, 48, np.zeros(24, np.uint8), True)
    with pytest.raises(InputError, match='one data entry per point'):
        read_session(write(tmp_path / 'run', (0, '/particles', CLOUD, short)))
