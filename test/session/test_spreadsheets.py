"""Importing: one truth written down in every way that laboratories do, and read back."""

import math
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from microbot_ros.common.errors import InputError
from microbot_ros.session import read_session
from microbot_ros.session.spreadsheets.assemble import import_session
from microbot_ros.session.spreadsheets.sheets import Answers

FRAMES, STEP = 400, 0.04
PIXEL = 0.33e-6
SHARED = Path(__file__).parents[2].parent / 'shared' / 'data' / 'rolling_robot'


class Truth:
    """Two robots that roll where they are told, 20° to the left; the second is seen later."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.dt = rng.uniform(0.9, 1.1, FRAMES) * STEP
        self.t = np.cumsum(self.dt)
        # A walk that turns both ways and goes all around.
        self.direction = np.repeat(np.cumsum(rng.normal(0, 2, FRAMES // 20)), 20)
        self.frequency = np.repeat(rng.integers(1, 9, FRAMES // 20), 20).astype(float)
        heading = self.direction + math.radians(20)
        step = 2e-6 * self.frequency * self.dt
        steps = step[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        walk = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)[:-1]])
        noise = rng.normal(0, 5e-8, (2, FRAMES, 2))
        self.first = walk + [5e-5, 6e-5] + noise[0]
        self.second = (walk + [9e-5, -3e-5] + noise[1])[50:]

    def check(self, session, ids=(0, 1), tol=1e-12) -> None:
        t, robots = self.t, [session.tracks.of(i) for i in ids]
        assert session.tracks.particles.tolist() == list(ids)
        for robot, position, times in zip(
                robots, (self.first, self.second), (t, t[50:]), strict=True):
            np.testing.assert_allclose(robot.t - robots[0].t[0], times - t[0], atol=1e-9)
            np.testing.assert_allclose(robot.position, position, atol=tol)

    def check_commands(self, session, atol=1e-9) -> None:
        commands, at = session.commands, self.t - self.t[0] + session.tracks.t[0] + 1e-6
        field = commands.field_at(at)
        unit = field / np.hypot(*field.T)[:, None]
        expected = np.column_stack([np.cos(self.direction), np.sin(self.direction)])
        np.testing.assert_allclose(unit, expected, atol=atol)
        np.testing.assert_allclose(commands.frequency_at(at), self.frequency)
        assert session.conditions.propulsion == 'rolling'
        assert len(commands.t) <= FRAMES // 20


TRUTH = Truth()


def write_csv(path: Path, names: list[str], columns: list, mark: str = ',', point: str = '.'):
    def cell(value) -> str:
        if isinstance(value, float) and math.isnan(value):
            return ''
        return str(value).replace('.', point)

    rows = zip(*[np.asarray(column).tolist() for column in columns], strict=True)
    lines = [mark.join(names), *(mark.join(map(cell, row)) for row in rows)]
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    return path


def write_book(path: Path, sheets: dict[str, tuple[list[str], list]]) -> Path:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, (names, columns) in sheets.items():
        page = book.create_sheet(name)
        page.append(names)
        for row in zip(*[np.asarray(column).tolist() for column in columns], strict=True):
            page.append(row)
    book.save(path)
    return path


def wide(scale: float = 1e-6, flip: int = 1) -> list:
    """x1, y1, x2, y2, the second blank until it is seen."""
    second = np.full((FRAMES, 2), np.nan)
    second[50:] = TRUTH.second
    return [column / scale * sign for points in (TRUTH.first, second)
            for column, sign in zip(points.T, (1, flip), strict=True)]


def test_a_wide_table_in_micrometres(tmp_path):
    names = ['time_s', 'x_0 (µm)', 'y_0 (µm)', 'x_1 (µm)', 'y_1 (µm)', 'direction [rad]', 'freq']
    path = write_csv(tmp_path / 'a.csv', names, [
        TRUTH.t, *wide(), TRUTH.direction, TRUTH.frequency])
    session, said = import_session(path, Answers())
    TRUTH.check(session)
    TRUTH.check_commands(session)
    assert any('gaps' in sentence for sentence in said)
    assert any('y points up' in sentence for sentence in said)
    assert any('leads the commands by 20°' in sentence for sentence in said)


def test_a_long_table_with_identities_below_each_other(tmp_path):
    t = np.concatenate([TRUTH.t, TRUTH.t[50:]])
    ids = np.repeat([4, 7], [FRAMES, FRAMES - 50])
    x, y = np.vstack([TRUTH.first, TRUTH.second]).T * 1e3
    path = write_csv(tmp_path / 'a.tsv', ['TrackID', 'Time [ms]', 'X (mm)', 'Y (mm)'], [
        ids, t * 1e3, x, y], mark='\t')
    session, said = import_session(path, Answers())
    TRUTH.check(session, ids=(4, 7))
    assert len(session.commands.t) == 0
    assert 'no commands' in said


def test_a_table_of_trackmate_with_its_four_lines_of_header(tmp_path):
    names = ['LABEL', 'ID', 'TRACK_ID', 'POSITION_X', 'POSITION_Y', 'POSITION_T', 'FRAME']
    words = [['Label', 'Spot ID', 'Track ID', 'X', 'Y', 'T', 'Frame'],
             ['Label', 'Spot ID', 'Track ID', 'X', 'Y', 'T', 'Frame'],
             ['', '', '', '(micron)', '(micron)', '(sec)', '']]
    t = np.concatenate([TRUTH.t, TRUTH.t[50:]])
    ids = np.repeat([0, 1], [FRAMES, FRAMES - 50])
    x, y = np.vstack([TRUTH.first, TRUTH.second]).T * 1e6
    labels = [f'ID{i}' for i in range(len(t))]
    path = write_csv(tmp_path / 'spots.csv', names, [
        labels, np.arange(len(t)), ids, x, y, t, np.rint(t / STEP)])
    header, body = path.read_text().split('\n', 1)
    path.write_text('\n'.join([header, *(','.join(row) for row in words), body]))
    session, _ = import_session(path, Answers(position_unit='_um'))
    TRUTH.check(session)


def robot_sheet(position: np.ndarray, start: int = 0) -> tuple[list[str], list]:
    x, y = position.T / PIXEL
    frames = np.arange(start, start + len(x)) + 11502
    return ['Frame', 'Times', 'Pos X', 'Pos Y', 'Area', 'Vel X'], [
        frames, TRUTH.dt[start:], x, -y, x * 0, x * 0]


def test_a_spreadsheet_with_a_sheet_per_robot_intervals_pixels_and_y_down(tmp_path):
    nothing = np.zeros(FRAMES)
    actions = ['Frame', 'Bx', 'By', 'Bz', 'Alpha', 'Gamma', 'Rolling Frequency']
    path = write_book(tmp_path / 'a.xlsx', {
        'Magnetic Field Actions': (actions, [
            np.arange(FRAMES) + 11502, nothing, nothing, nothing,
            (TRUTH.direction + math.pi) % (2 * math.pi) - math.pi, nothing + 1.57,
            TRUTH.frequency]),
        'Robot 1': robot_sheet(TRUTH.first), 'Robot 2': robot_sheet(TRUTH.second, 50),
        'Notes': (['who', 'when'], [['me'], ['today']]),
    })
    session, said = import_session(path, Answers(pixel_size=PIXEL))
    TRUTH.check(session, ids=(1, 2))
    TRUTH.check_commands(session)
    assert session.conditions.pixel_size == PIXEL
    assert session.conditions.frame_rate == pytest.approx(1 / STEP, rel=0.02)
    for expected in ('intervals', 'y points down', 'Notes: holds neither', 'in radians',
                     'on the clock of Robot 1', 'matched row by row to Robot 1'):
        assert any(expected in sentence for sentence in said), expected


def test_a_folder_with_a_file_per_robot_and_commands_by_frame(tmp_path):
    for i, (points, start) in enumerate(((TRUTH.first, 0), (TRUTH.second, 50))):
        x, y = points.T * 1e6
        frames = np.arange(start, FRAMES)
        write_csv(tmp_path / f'robot{i}.csv', ['frame', 't_s', 'x_um', 'y_um'], [
            frames, TRUTH.t[start:], x, y])
    changes = np.arange(0, FRAMES, 20)
    write_csv(tmp_path / 'field.csv', ['frame', 'direction_deg', 'frequency_hz'], [
        changes, np.degrees(TRUTH.direction[changes]), TRUTH.frequency[changes]])
    session, said = import_session(tmp_path, Answers())
    TRUTH.check(session)
    TRUTH.check_commands(session)
    assert any('by frame' in sentence for sentence in said)


def commanded(tmp_path: Path, name: str, angle: np.ndarray) -> Path:
    x, y = TRUTH.first.T * 1e6
    return write_csv(tmp_path / 'a.csv', ['t_s', 'x_um', 'y_um', name, 'frequency'], [
        TRUTH.t, x, y, angle, TRUTH.frequency])


def test_degrees_that_turn_clockwise_are_turned_over(tmp_path):
    path = commanded(tmp_path, 'Direction', -np.degrees(TRUTH.direction))
    session, said = import_session(path, Answers())
    TRUTH.check_commands(session)
    assert any('in degrees' in sentence for sentence in said)
    assert any('clockwise' in sentence for sentence in said)
    kept, _ = import_session(path, Answers(angle_sense='counterclockwise'))
    np.testing.assert_allclose(kept.commands.field[:, 1], -session.commands.field[:, 1])


@pytest.mark.parametrize('off', [90, -90])
def test_angles_off_by_a_right_angle_are_asked_about(tmp_path, off):
    # The robot itself leads by 20°: with 20° to spare either side this is not taken for 90°.
    angle = TRUTH.direction + math.radians(20 + off)
    path = commanded(tmp_path, 'direction_rad', angle)
    with pytest.raises(InputError, match='--angle-offset-deg') as question:
        import_session(path, Answers())
    assert f'{off} if the angles count' in str(question.value)
    session, _ = import_session(path, Answers(angle_offset=math.radians(20 + off)))
    TRUTH.check_commands(session)
    kept, _ = import_session(path, Answers(angle_offset=0.0))
    z = kept.commands.field @ [1, 1j]
    np.testing.assert_allclose(
        np.exp(1j * np.angle(z)), np.exp(1j * angle[::20]), atol=1e-9)


def test_angles_that_motion_does_not_follow_are_kept(tmp_path):
    rng = np.random.default_rng(1)
    angle = np.repeat(rng.uniform(-3, 3, FRAMES), 1)
    session, said = import_session(commanded(tmp_path, 'direction_rad', angle), Answers())
    assert any('no common direction' in sentence for sentence in said)
    z = session.commands.field @ [1, 1j]
    np.testing.assert_allclose(np.exp(1j * np.angle(z)), np.exp(1j * angle), atol=1e-9)


def test_a_uniform_field_needs_a_unit_and_keeps_its_components(tmp_path):
    bx, by = 5 * np.cos(TRUTH.direction), 5 * np.sin(TRUTH.direction)
    x, y = TRUTH.first.T * 1e6
    path = write_csv(tmp_path / 'a.csv', ['t_s', 'x_um', 'y_um', 'Bx', 'By'], [
        TRUTH.t, x, y, bx, by])
    with pytest.raises(InputError, match='--field-unit'):
        import_session(path, Answers())
    session, _ = import_session(path, Answers(field_unit='_G'))
    np.testing.assert_allclose(
        session.commands.field_at(TRUTH.t), 1e-4 * np.column_stack([bx, by]))
    assert session.commands.frequency is None
    assert session.conditions.propulsion == 'catalytic'


@pytest.mark.parametrize('name', ['b{}_mT', 'B{}_mT', 'B{} mT', 'B{} (mT)', 'B{}[mT]'])
def test_a_field_in_millitesla_is_one_however_it_is_written(tmp_path, name):
    bx, by = 5 * np.cos(TRUTH.direction), 5 * np.sin(TRUTH.direction)
    names = ['t_s', 'x_um', 'y_um', name.format('x'), name.format('y')]
    path = write_csv(tmp_path / 'a.csv', names, [TRUTH.t, *TRUTH.first.T * 1e6, bx, by])
    session, _ = import_session(path, Answers())
    np.testing.assert_allclose(
        session.commands.field_at(TRUTH.t), 1e-3 * np.column_stack([bx, by]))


def test_headings_turn_with_the_picture(tmp_path):
    theta = np.degrees(TRUTH.direction)
    x, y = TRUTH.first.T / PIXEL
    path = write_csv(tmp_path / 'a.csv', ['t_s', 'x_px', 'y_px', 'theta_deg'], [
        TRUTH.t, x, -y, -theta])
    session, _ = import_session(path, Answers(pixel_size=PIXEL))
    np.testing.assert_allclose(session.tracks.theta, TRUTH.direction)


def test_frames_become_times_by_the_frame_rate(tmp_path):
    path = small(tmp_path, 'Frame,x_um,y_um\n10,1,2\n11,1,2\n13,1,2\n')
    session, _ = import_session(path, Answers(frame_rate=20.0))
    np.testing.assert_allclose(session.tracks.t, [0.5, 0.55, 0.65])
    assert session.conditions.frame_rate == 20


def test_what_people_say_of_times_overrules_what_they_look_like(tmp_path):
    path = small(tmp_path, 'time,x_um,y_um\n1,1,2\n2,1,2\n4,1,2\n')
    session, _ = import_session(path, Answers(times='intervals', time_unit='_ms'))
    np.testing.assert_allclose(session.tracks.t, [1e-3, 3e-3, 7e-3])


@pytest.mark.parametrize(('t', 'line'), [
    ([*range(30), 29, *range(30, 40)], 32), ([*range(30), 28.9, *range(30, 60)], 32),
    (np.round(np.arange(40) / 1.2), 5)], ids=['repeats', 'goes back', 'rounded'])
@pytest.mark.parametrize('heading', ['t_s', 't'])
def test_moments_of_which_one_repeats_or_goes_back_are_no_intervals(tmp_path, heading, t, line):
    rows = ''.join(f'{0.03 * one:.3f},{k},0\n' for k, one in enumerate(t))
    with pytest.raises(InputError, match=f"expected ascending times in '{heading}'") as refusal:
        import_session(small(tmp_path, f'{heading},x_um,y_um\n{rows}'), Answers())
    assert refusal.value.line == line


def test_robots_below_each_other_without_an_identity_are_no_intervals(tmp_path):
    rows = ''.join(f'{name},{k / 20},{k},{90 * name}\n' for name in (1, 2) for k in range(40))
    with pytest.raises(InputError, match='expected ascending times') as refusal:
        import_session(small(tmp_path, 'Object,t_s,x_um,y_um\n' + rows), Answers())
    assert refusal.value.line == 42


def test_dates_of_a_spreadsheet_are_times(tmp_path):
    start = datetime(2024, 3, 31, 1, 59, 59)
    stamps = [start + timedelta(milliseconds=500 * i) for i in range(4)]
    book = openpyxl.Workbook()
    for row in (['Time', 'x_um', 'y_um'], *([stamp, 1, 2] for stamp in stamps)):
        book.active.append(row)
    book.save(tmp_path / 'a.xlsx')
    session, _ = import_session(tmp_path / 'a.xlsx', Answers())
    np.testing.assert_allclose(np.diff(session.tracks.t), 0.5)


def test_a_direction_without_frequency_or_size_is_a_field_of_1_mT(tmp_path):
    rows = 't_s,x_um,y_um,direction_deg\n0,0,0,\n1,1,1,90\n2,0,0,90\n3,1,0,180\n'
    session, said = import_session(small(tmp_path, rows), Answers())
    assert session.commands.t.tolist() == [1, 3]
    np.testing.assert_allclose(session.commands.field, [[0, 1e-3], [-1e-3, 0]], atol=1e-18)
    assert session.commands.frequency is None
    assert any('1 mT' in sentence for sentence in said)


@pytest.mark.parametrize('blank', ['', '90'])
def test_a_drive_that_is_off_needs_no_direction(tmp_path, blank):
    """A row with frequency 0 is a command to stop, whatever its direction."""
    rows = ''.join(f'{k},{k},0,{"0,5" if k // 10 % 2 == 0 else f"{blank},0"}\n'
                   for k in range(40))
    path = small(tmp_path, 't_s,x_um,y_um,direction_deg,frequency_hz\n' + rows)
    commands = import_session(path, Answers(angle_offset=0.0))[0].commands
    assert commands.t.tolist() == [0, 10, 20, 30]
    assert commands.frequency.tolist() == [5, 0, 5, 0]
    np.testing.assert_allclose(commands.field[::2], [[1e-3, 0]] * 2, atol=1e-18)


def test_a_drive_whose_direction_is_not_known_is_no_command(tmp_path):
    rows = 't_s,x_um,y_um,direction_deg,frequency_hz\n0,0,0,0,5\n1,1,0,,5\n2,2,0,0,4\n'
    commands = import_session(small(tmp_path, rows), Answers(angle_offset=0.0))[0].commands
    assert commands.t.tolist() == [0, 2]


@pytest.mark.parametrize(('field', 'said'), [
    ('direction_deg,freq\n90,1\n', r'the 3 rows of a; found 1 rows'),
    ('frame,direction_deg,freq\n90,4,1\n', r'frames 1 to 3'),
    ('t_s,direction_deg,freq\n0,,1\n', r'expected commands, found none'),
])
def test_commands_that_nothing_ties_to_the_tracks_are_refused(tmp_path, field, said):
    (tmp_path / 'a.csv').write_text('frame,t_s,x_um,y_um\n1,0,1,2\n2,1,1,2\n3,2,1,2\n')
    (tmp_path / 'field.csv').write_text(field)
    with pytest.raises(InputError, match=said) as refusal:
        import_session(tmp_path, Answers())
    assert refusal.value.source.endswith('field.csv')


@pytest.mark.parametrize(('first', 'second'), [((0, 6), (3, 5)), ((3, 6), (0, 5))])
def test_the_common_clock_begins_with_the_first_robot_and_ends_with_the_last(
        tmp_path, first, second):
    for name, (start, rows) in (('robot1', first), ('robot2', second)):
        lines = [f'{frame},{0.1 if frame % 2 else 0.12},1,2'
                 for frame in range(start, start + rows)]
        (tmp_path / f'{name}.csv').write_text('\n'.join(['frame,times,x_um,y_um', *lines]))
    session, _ = import_session(tmp_path, Answers())
    of = {}
    for name, (start, rows) in ((1, first), (2, second)):
        own = session.tracks.of(name)
        assert len(own.t) == rows
        of |= {(name, start + k): t for k, t in enumerate(own.t)}
    both = [frame for name, frame in of if name == 1 and (2, frame) in of]
    assert both
    assert [of[1, frame] for frame in both] == [of[2, frame] for frame in both]
    every = sorted({frame: t for (_, frame), t in of.items()}.items())
    steps = np.diff([t for _, t in every])
    np.testing.assert_allclose(steps, [0.1 if frame % 2 else 0.12 for frame, _ in every[1:]])


def two_robots(path: Path, unit: str = 'um', later: float = 0.0) -> Path:
    """Two robots at 20 frames a second, the second in another `unit` and `later` [s]."""
    t, x = np.arange(30) / 20, np.arange(30.0)
    return write_book(path, {
        'Robot 1': (['t_s', 'x [um]', 'y [um]'], [t, x, 0 * x]),
        'Robot 2': (['t_s', f'x [{unit}]', f'y [{unit}]'], [t + later, x, x + 90])})


def test_robots_of_several_units_are_refused_unless_one_is_stated(tmp_path):
    path = two_robots(tmp_path / 'a.xlsx', 'mm')
    with pytest.raises(InputError, match=r"positions in um .* of Robot 1, found 'x \[mm\]'"):
        import_session(path, Answers())
    session, _ = import_session(path, Answers(position_unit='_mm'))
    for robot in (1, 2):
        assert np.ptp(session.tracks.of(robot).position[:, 0]) == pytest.approx(29e-3)


def test_a_unit_on_x_counts_for_y(tmp_path):
    path = small(tmp_path, 't_s,x_um,y\n0,1,2\n1,3,4\n')
    session, _ = import_session(path, Answers())
    np.testing.assert_allclose(session.tracks.position, [[1e-6, 2e-6], [3e-6, 4e-6]])
    with pytest.raises(InputError, match="found 'y_mm'"):
        import_session(small(tmp_path, 't_s,x_um,y_mm\n0,1,2\n1,3,4\n'), Answers())


def test_the_frame_rate_is_that_of_a_robot_whatever_the_clock_of_another(tmp_path):
    path = two_robots(tmp_path / 'a.xlsx', later=1e-3)
    session, _ = import_session(path, Answers())
    assert session.conditions.frame_rate == pytest.approx(20)


def small(tmp_path: Path, text: str) -> Path:
    (tmp_path / 'a.csv').write_text(text)
    return tmp_path / 'a.csv'


@pytest.mark.parametrize(('text', 'said', 'line'), [
    ('t_s,x,y\n0,1,2\n1,1,2\n', '--position-unit', None),
    ('t_s,x_px,y_px\n0,1,2\n1,1,2\n', '--pixel-size-um', None),
    ('t,x_um,y_um\n0,1,2\n40,1,2\n80,1,2\n', '--time-unit', None),
    ('frame,x_um,y_um\n0,1,2\n40,1,2\n', '--frame-rate-hz', None),
    ('x_um,y_um\n0,1\n40,1\n', '--column time=NAME', None),
    ('t_s,here,there\n0,1,2\n', 't_s, here, there', None),
    ('t_s,x_um\n0,1\n', '--column x=NAME', None),
    ('t_s,x_um,y_um\n0,1,2\n1,oops,2\n', "found 'oops'", 3),
    ('t_s,x_um,y_um\n0,1,2\n1,inf,2\n', "found 'inf'", 3),
    ('t_s,x_um,y_um\n0,1,2\n1,1,2\n0.5,1,2\n900,1,2\n', 'expected ascending times', 4),
    ('t_s,x_um,y_um\n0,1,2\n,1,2\n', "a time in 't_s'", 3),
    ('t_s,particle,x_um,y_um\n0,1,1,2\n0,1,1,2\n', 'one row per robot', None),
    ('t_s,particle,x_um,y_um\n0,1.5,1,2\n', 'whole numbers', 2),
    ('t_s,x_um,y_um,pos x\n0,1,2,3\n', "--column x='x_um'", None),
    ('t_s,x_um,y_um\n0,1,2,9\n', 'expected 3 values, found 4', 2),
    ('t_s,x_um,y_um\n0,,\n', 'expected positions', None),
    ('t_s,x_um,y_um\n', 'rows below', None),
    ('', 'header', None),
    ('t_s,x_um,y_um,alpha,freq\n0,0,0,1,1\n1,1,1,2,1\n', '--angle-unit', None),
    ('t_s,x1_um,y2_um,y1_um,x3_um\n0,0,0,1,1\n', "a y beside 'x3_um'", None),
])
def test_what_is_wrong_or_open_is_named(tmp_path, text, said, line):
    with pytest.raises(InputError, match=said.replace('(', r'\(')) as refusal:
        import_session(small(tmp_path, text), Answers())
    assert refusal.value.source.endswith('a.csv')
    assert refusal.value.line == line


def test_names_that_nobody_guesses_can_be_told(tmp_path):
    path = small(tmp_path, 'Zeit,Ort waagrecht,Ort senkrecht\n0,1,2\n1,3,4\n')
    named = {'time': 'Zeit', 'x': 'Ort waagrecht', 'y': 'Ort senkrecht'}
    session, _ = import_session(path, Answers(columns=named, position_unit='_mm'))
    np.testing.assert_allclose(session.tracks.position, [[1e-3, 2e-3], [3e-3, 4e-3]])
    assert session.tracks.t.tolist() == [0, 1]


def test_files_that_are_no_tables_are_refused(tmp_path):
    for name, content in (('a.xlsx', b'no zip'), ('a.xls', b''), ('b.csv', b'\xff\xfe\x00')):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match='expected') as refusal:
            import_session(tmp_path / name, Answers())
        assert refusal.value.source.endswith(name)
    with pytest.raises(InputError, match='found nothing'):
        import_session(tmp_path / 'nowhere.csv', Answers())
    (tmp_path / 'empty').mkdir()
    with pytest.raises(InputError, match='files ending in'):
        import_session(tmp_path / 'empty', Answers())


@pytest.mark.skipif(not SHARED.exists(), reason='the shared recordings are not here')
def test_a_session_imports_as_itself(tmp_path):
    session = read_session(SHARED)
    (tmp_path / 'tracks.csv').write_bytes((SHARED / 'tracks.csv').read_bytes())
    (tmp_path / 'commands.csv').write_bytes((SHARED / 'commands.csv').read_bytes())
    copy, _ = import_session(tmp_path, Answers())
    np.testing.assert_allclose(copy.tracks.position, session.tracks.position)
    np.testing.assert_array_equal(copy.tracks.t, session.tracks.t)
    np.testing.assert_allclose(copy.commands.field, session.commands.field, atol=1e-15)


@pytest.mark.parametrize(('x', 'y'), [
    ('Robot X [px]', 'Robot Y [px]'), ('center_x (px)', 'center_y (px)'),
    ('X coordinate [px]', 'Y coordinate [px]'), ('CentreX px', 'CentreY px')])
def test_places_by_whatever_name(tmp_path, x, y):
    path = tmp_path / 'a.csv'
    path.write_text(f'Time (s),{x},{y}\n' + ''.join(f'{k / 10},{k},{2 * k}\n' for k in range(9)))
    session, _ = import_session(path, Answers(pixel_size=PIXEL))
    assert session.tracks.position[-1] - session.tracks.position[0] == pytest.approx(
        [8 * PIXEL, -16 * PIXEL])
