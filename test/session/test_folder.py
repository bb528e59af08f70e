"""CSV sessions: exact both ways, and errors that name file, line and expectation."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.common.tables import to_text
from microbot_ros.common.units import exact_si
from microbot_ros.session import read_session, write_session

ROLLING_ROBOT = Path(__file__).parents[2].parent / 'shared' / 'data' / 'rolling_robot'

TRACKS = 't_s,particle,x_um,y_um\n0.0,0,1.5,2\n0.0,1,4,5\n0.1,0,1.6,2.1\n0.1,1,4,5\n'
COMMANDS = 't_s,bx_mT,by_mT\n0.0,1.5,-2\n0.05,0,1\n'


def folder(path: Path, tracks: str = TRACKS, commands: str | None = COMMANDS, yaml: str = ''):
    (path / 'tracks.csv').write_text(tracks)
    if commands is not None:
        (path / 'commands.csv').write_text(commands)
    if yaml:
        (path / 'session.yaml').write_text(yaml)
    return path


def same(a: Session, b: Session) -> None:
    for name in ('t', 'particle', 'position', 'theta', 'sigma'):
        np.testing.assert_array_equal(getattr(a.tracks, name), getattr(b.tracks, name), name)
    np.testing.assert_array_equal(a.commands.t, b.commands.t)
    np.testing.assert_array_equal(a.commands.field, b.commands.field)
    assert (a.commands.frequency is None) == (b.commands.frequency is None)
    np.testing.assert_array_equal(a.commands.tilt, b.commands.tilt)
    assert (a.assumed, a.speed_window) == (b.assumed, b.speed_window)
    values, others = (dict(vars(session.conditions)) for session in (a, b))
    assert values.pop('propulsion') == others.pop('propulsion')
    # YAML's numbers are doubles before their unit is taken off: one rounding.
    assert [*values.values()] == pytest.approx([*others.values()], rel=3e-16)


def test_reads_si_values_from_the_units_of_the_names(tmp_path):
    session = read_session(folder(tmp_path, yaml='radius_um: 2.5\nviscosity_mPa_s: 0.9\n'))
    assert session.tracks.position[0].tolist() == [1.5e-6, 2e-6]
    assert session.tracks.particle.tolist() == [0, 1, 0, 1]
    assert np.isnan(session.tracks.theta).all()
    assert session.commands.field[0].tolist() == [1.5e-3, -2e-3]
    assert session.commands.frequency is None
    assert session.conditions == Conditions(radius=2.5e-6, viscosity=0.9e-3)
    assert session.name == tmp_path.name


def test_rolling_commands_point_where_they_say_and_make_the_session_rolling(tmp_path):
    rows = 't_s,direction_rad,frequency_hz\n0,0,0\n0.05,1.5707963267948966,7\n'
    session = read_session(folder(tmp_path, commands=rows, yaml='reference_field_mT: 3\n'))
    np.testing.assert_allclose(session.commands.field, [[3e-3, 0], [0, 3e-3]], atol=1e-18)
    assert session.commands.frequency.tolist() == [0, 7]
    assert session.conditions.propulsion == 'rolling'


def test_without_commands_nothing_was_commanded(tmp_path):
    session = read_session(folder(tmp_path, commands=None))
    assert len(session.commands.t) == 0
    assert session.commands.field_at(session.tracks.t).tolist() == [[0, 0]] * 4


def test_rows_may_come_particle_by_particle_and_columns_in_any_order(tmp_path):
    rows = 'particle,y_um,x_um,t_s,frame,x_px\n1,5,4,0,0,9\n1,5,4,0.1,1,9\n0,2,1.5,0,0,9\n'
    tracks = read_session(folder(tmp_path, rows)).tracks
    assert tracks.t.tolist() == [0, 0, 0.1]
    assert tracks.particle.tolist() == [0, 1, 1]
    assert tracks.position[0].tolist() == [1.5e-6, 2e-6]


def test_an_unknown_heading_is_an_empty_cell(tmp_path):
    rows = 't_s,particle,x_um,y_um,theta_rad\n0,0,1,2,\n0.1,0,1,2,-3.1\n'
    theta = read_session(folder(tmp_path, rows)).tracks.theta
    assert np.isnan(theta[0])
    assert theta[1] == -3.1


@pytest.mark.parametrize(('tracks', 'line', 'said'), [
    ('', None, 'empty file'),
    ('\n\n', None, 'empty file'),
    ('t_s,particle,x_um,y_um\n', 1, 'rows below the header'),
    ('t,particle,x_um,y_um\n0,0,1,2\n', 1, 't_s,particle,x_um,y_um'),
    ('t_s,particle,x_um\n0,0,1\n', 1, 't_s,particle,x_um,y_um'),
    ('t_s,particle,x_um,x_um,y_um\n0,0,1,1,2\n', 1, 'expected the header'),
    ('t_s;particle;x_um;y_um\n0;0;1;2\n', 1, 'separated by commas'),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0,1,0,1,5,2,0\n', 3, 'decimal sign'),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n\n0.1,0,1\n', 4, '4 values'),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0.1,0,nan,2\n', 3, "'x_um', found 'nan'"),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0.1,0,1,-inf\n', 3, "'y_um', found '-inf'"),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n1e999,0,1,2\n', 3, "'t_s', found '1e999'"),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0.1,0,,2\n', 3, 'an empty cell'),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0.1,0,1 um,2\n', 3, "'1 um'"),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0.1,0,1_0,2\n', 3, "'1_0'"),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0.1,0.5,1,2\n', 3, 'whole number'),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0,1,1,2\n0.2,0,1,2\n0.1,0,1,2\n', 5, 'ascend'),
    ('t_s,particle,x_um,y_um\n0,0,1,2\n0,1,1,2\n0,0,1,2\n', 4, 'one row per particle'),
    ('t_s,particle,x_um,y_um,theta_rad\n0,0,1,2,nan\n', 2, "'theta_rad', found 'nan'"),
])
def test_bad_tracks_are_refused_with_file_and_line(tmp_path, tracks, line, said):
    with pytest.raises(InputError, match=said) as refusal:
        read_session(folder(tmp_path, tracks))
    assert refusal.value.source.endswith('tracks.csv')
    assert refusal.value.line == line


@pytest.mark.parametrize(('commands', 'line', 'said'), [
    ('', None, 'empty file'),
    ('t_s,bx_mT\n0,1\n', 1, 't_s,bx_mT,by_mT or t_s,direction_rad,frequency_hz'),
    ('t_s,bx_mT,by_mT\n0,1,NaN\n', 2, "'by_mT', found 'NaN'"),
    ('t_s,bx_mT,by_mT\n0,1,1\n0.2,1,1\n0.1,1,1\n', 4, 'ascend'),
    ('t_s,bx_mT,by_mT\n0,1,1\n0,1,2\n', 3, 'one row per time'),
    ('t_s,bx_mT,by_mT\n0.11,1,1\n', 2, 'before the tracks end at 0.1 s'),
])
def test_bad_commands_are_refused_with_file_and_line(tmp_path, commands, line, said):
    with pytest.raises(InputError, match=said) as refusal:
        read_session(folder(tmp_path, commands=commands))
    assert refusal.value.source.endswith('commands.csv')
    assert refusal.value.line == line


@pytest.mark.parametrize(('yaml', 'said'), [
    ('propulsion: magic', 'propulsion'), ('radius_um: -1', 'radius_um'),
    ('radius_um: .nan', 'radius_um'), ('raduis_um: 1', 'raduis_um'),
    ('{radius_um: 2.3, height_um: 2.3}', 'more than radius_um, 2.3'),
    ('{height_um: 2, radius_um: 2.3}', 'more than radius_um, 2.3'),
    ('height_um: .inf', 'height_um'), ('height_um: .nan', 'height_um'),
    ('height_um: 0', 'height_um'),
])
def test_bad_conditions_are_refused(tmp_path, yaml, said):
    with pytest.raises(InputError, match=said) as refusal:
        read_session(folder(tmp_path, yaml=yaml))
    assert refusal.value.source.endswith('session.yaml')
    assert refusal.value.line == 1


def test_bytes_that_are_no_text_are_refused(tmp_path):
    folder(tmp_path)
    (tmp_path / 'tracks.csv').write_bytes(b'\xff\xfe\x00t')
    with pytest.raises(InputError, match='no text'):
        read_session(tmp_path)


def test_a_folder_without_tracks_and_a_missing_one_are_refused(tmp_path):
    with pytest.raises(InputError, match='tracks'):
        read_session(tmp_path)
    with pytest.raises(InputError, match='found nothing'):
        read_session(tmp_path / 'nowhere')
    (tmp_path / 'recording').mkdir()
    (tmp_path / 'recording' / 'recording_0.mcap').touch()
    with pytest.raises(InputError, match='recording in it is one'):
        read_session(tmp_path)


FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=60)
@given(FINITE, st.sampled_from(['x_um', 'bx_mT', 't_s', 'viscosity_mPa_s', 'force_pN']))
def test_every_number_survives_its_unit_bit_for_bit(value, name):
    assert exact_si(name, to_text(value, name)) == value


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.booleans())
def test_a_session_survives_the_round_trip(tmp_path_factory, seed, with_heading):
    rng = np.random.default_rng(seed)
    frames, particles = 5, 3
    t = np.repeat(np.sort(rng.uniform(0, 9, frames)), particles)
    seen = rng.random(len(t)) < 0.8
    seen[0] = True
    theta = rng.uniform(-4, 4, len(t)) if with_heading else np.full(len(t), np.nan)
    tracks = Tracks(
        t[seen], np.tile(np.arange(particles), frames)[seen],
        rng.normal(0, 1e-5, (len(t), 2))[seen], theta[seen], np.full(seen.sum(), np.nan),
    )
    commands = Commands(np.sort(rng.uniform(-1, 0, 4)), rng.normal(0, 1e-3, (4, 2)))
    conditions = Conditions('catalytic', *rng.uniform(
        (1e-8, 1e-6, 1, 1e-3, 1e-9, 1e-6), (1e-2, 300, 300, 300, 1e-2, 9)).tolist(),
        height=float(rng.uniform(1e-2, 1e-1)))
    session = Session(tracks, commands, conditions)
    path = tmp_path_factory.mktemp('session') / 'copy'
    write_session(path, session)
    same(read_session(path), session)


def test_a_rolling_session_keeps_frequency_and_magnitude(tmp_path):
    session = read_session(folder(tmp_path))
    field = np.array([[3e-3, 4e-3], [0, -2e-3]])
    commands = Commands(np.array([0, 0.05]), field, np.array([0.0, 11.0]))
    rolling = Session(session.tracks, commands, Conditions('rolling'))
    write_session(tmp_path / 'copy', rolling)
    copy = read_session(tmp_path / 'copy').commands
    np.testing.assert_allclose(copy.field, field, atol=1e-18)
    np.testing.assert_array_equal(copy.frequency, commands.frequency)


def test_writing_over_a_session_leaves_no_command_of_the_old_one(tmp_path):
    session = read_session(folder(tmp_path))
    silent = Session(session.tracks, Commands(np.empty(0), np.empty((0, 2))))
    write_session(tmp_path, silent)
    assert len(read_session(tmp_path).commands.t) == 0


def test_nothing_is_written_of_tracks_that_hold_nan(tmp_path):
    session = read_session(folder(tmp_path))
    session.tracks.position[2, 0] = np.nan
    with pytest.raises(ValueError, match='position'):
        write_session(tmp_path / 'copy', session)
    assert not (tmp_path / 'copy').exists()


@pytest.mark.skipif(not ROLLING_ROBOT.exists(), reason='the shared recordings are not here')
def test_the_recorded_rolling_robot_loads_and_survives(tmp_path):
    session = read_session(ROLLING_ROBOT)
    assert len(session.tracks.t) == 11867
    assert session.conditions == Conditions('rolling', frame_rate=23.4, pixel_size=0.33e-6)
    assert session.commands.frequency.max() == 40
    write_session(tmp_path / 'copy', session)
    copy = read_session(tmp_path / 'copy')
    np.testing.assert_array_equal(copy.tracks.position, session.tracks.position)
    np.testing.assert_allclose(copy.commands.field, session.commands.field, atol=1e-18)
