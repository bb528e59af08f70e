"""The scale, units and identities that a table tells itself, in as many ways as tables do."""

import math
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import SpeedWindow
from microbot_ros.session import read_session, write_session
from microbot_ros.session.spreadsheets.assemble import import_session
from microbot_ros.session.spreadsheets.scale import speed_ratio
from microbot_ros.session.spreadsheets.sheets import Answers

SHARED = Path(__file__).parents[2].parent / 'shared' / 'data' / 'speed_vs_frequency'
ROWS = 600


class Walk:
    """A robot that rolls to and fro and around, in pixels with y down, and its intervals."""

    def __init__(self, seed: int = 1, rows: int = ROWS) -> None:
        rng = np.random.default_rng(seed)
        self.dt = 0.04 * rng.uniform(0.8, 1.3, rows)
        self.t = np.cumsum(self.dt)
        self.alpha = np.repeat(np.cumsum(rng.normal(0, 1.5, rows // 40)), 40)
        self.alpha = (self.alpha + np.pi) % (2 * np.pi) - np.pi
        self.frequency = np.repeat(1.0 + np.arange(rows // 40) % 10, 40)
        step = 3 * self.frequency * self.dt * np.exp(-1j * self.alpha)
        noise = rng.normal(0, 0.1, (2, rows))
        self.z = 700 + 500j + np.cumsum(step) - step[0] + noise[0] + 1j * noise[1]

    def speed(self, pixel: float, frames: int, base: str) -> np.ndarray:
        """As a tracker writes it [µm/s]; 0 until there are enough frames."""
        moved = np.abs(self.z[frames:] - self.z[:-frames])
        time = {'elapsed': self.t[frames:] - self.t[:-frames],
                'last_interval': frames * self.dt[frames:], 'frames': frames}[base]
        return np.r_[np.zeros(frames), pixel * moved / time]


def write(path: Path, robots: dict[str, dict], field: dict | None = None) -> Path:
    book = openpyxl.Workbook()
    book.remove(book.active)
    sheets = ({'Magnetic Field Actions': field} if field else {}) | robots
    for name, columns in sheets.items():
        page = book.create_sheet(name)
        page.append(list(columns))
        for row in zip(*[np.asarray(column).tolist() for column in columns.values()],
                       strict=True):
            page.append([None if isinstance(x, float) and math.isnan(x) else x for x in row])
    book.save(path)
    return path


def robot(walk: Walk, speed: np.ndarray, rows: slice = slice(None), first: int = 100) -> dict:
    frames = first + np.arange(len(walk.t))
    columns = {'Frame': frames, 'Times': walk.dt, 'Pos X': walk.z.real, 'Pos Y': walk.z.imag,
               'Vel Mag': speed}
    return {name: column[rows] for name, column in columns.items()}


def actions(walk: Walk, **changed) -> dict:
    nothing = np.zeros(len(walk.t))
    return {'Frame': 100 + np.arange(len(walk.t)), 'Bx': nothing, 'By': nothing, 'Bz': nothing,
            'Alpha': walk.alpha, 'Gamma': nothing + 1.570796,
            'Rolling Frequency': walk.frequency, 'Psi': nothing + 1.570796} | changed


@pytest.mark.parametrize('base', ['elapsed', 'last_interval', 'frames'])
@pytest.mark.parametrize(('pixel', 'frames'), [
    (0.1725, 15), (0.345, 2), (0.69, 4), (0.8625, 30)])
def test_speeds_beside_pixels_tell_their_size(tmp_path, pixel, frames, base):
    walk = Walk()
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(pixel, frames, base))},
                 actions(walk))
    session, said = import_session(path, Answers())
    assert session.conditions.pixel_size == pytest.approx(pixel * 1e-6, rel=1e-4)
    assert session.speed_window == SpeedWindow(frames, base)
    assert any(f'pixels of {pixel:g} µm' in sentence for sentence in said)
    moved = session.tracks.position[-1] - session.tracks.position[0]
    expected = pixel * 1e-6 * (walk.z[-1] - walk.z[0]).conjugate()
    assert moved.tolist() == pytest.approx([expected.real, expected.imag], rel=1e-4)


def test_smoothed_speeds_tell_the_size_to_a_few_percent():
    for seed in range(4):
        walk = Walk(seed, 2000)
        speed = np.convolve(walk.speed(0.345, 6, 'elapsed'), np.ones(3) / 3)[:2000]
        found = speed_ratio(speed, walk.z, walk.t)
        assert not found.exact
        assert abs(found.value / 0.345 - 1) < max(found.error, 0.03)


@pytest.mark.parametrize('speed', [
    np.full(ROWS, np.nan), np.full(ROWS, np.inf), np.zeros(ROWS),
    np.random.default_rng(2).uniform(0, 50, ROWS), Walk().speed(1.0, 5, 'elapsed')])
def test_speeds_that_tell_nothing_leave_the_question_open(tmp_path, speed):
    walk = Walk()
    columns = robot(walk, np.where(np.isfinite(speed), speed, 0.0))
    if not np.isfinite(speed).all():
        columns['Vel Mag'] = np.full(ROWS, 'n.a.')
    path = write(tmp_path / 'a.xlsx', {'Robot 1': columns}, actions(walk))
    with pytest.raises(InputError, match='--position-unit'):
        import_session(path, Answers())
    session, _ = import_session(path, Answers(pixel_size=0.5e-6))
    assert session.conditions.pixel_size == 0.5e-6


def test_a_stated_size_that_the_speeds_contradict_is_refused_by_name(tmp_path):
    walk = Walk()
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(0.345, 5, 'elapsed'))})
    with pytest.raises(InputError, match=r"0.69 contradicts 'Vel Mag' of Robot 1.* 0.345 µm"):
        import_session(path, Answers(pixel_size=0.69e-6))
    session, _ = import_session(path, Answers(pixel_size=0.69e-6, ignore_speed=True))
    assert session.conditions.pixel_size == 0.69e-6
    near, said = import_session(path, Answers(pixel_size=0.348e-6))
    assert near.conditions.pixel_size == 0.348e-6
    assert any('as stated; the speeds agree' in sentence for sentence in said)
    with pytest.raises(InputError, match='--position-unit px, or --ignore-speed'):
        import_session(path, Answers(position_unit='_um'))


def test_robots_of_two_scales_and_a_scale_that_changes_are_refused(tmp_path):
    one, other = Walk(1), Walk(2)
    path = write(tmp_path / 'a.xlsx', {
        'Robot 1': robot(one, one.speed(0.345, 5, 'elapsed')),
        'Robot 2': robot(other, other.speed(0.69, 5, 'elapsed'))})
    with pytest.raises(InputError, match=r'expected one scale.*--ignore-speed'):
        import_session(path, Answers())
    changing = np.r_[one.speed(0.345, 5, 'elapsed')[:400], one.speed(0.69, 5, 'elapsed')[400:]]
    path = write(tmp_path / 'b.xlsx', {'Robot 1': robot(one, changing)})
    with pytest.raises(InputError, match=r'in most rows and 0.69 in others') as refusal:
        import_session(path, Answers())
    assert refusal.value.line == 402
    session, _ = import_session(path, Answers(pixel_size=0.5e-6, ignore_speed=True))
    assert session.conditions.pixel_size == 0.5e-6


def test_a_robot_too_short_to_tell_has_the_scale_of_the_others(tmp_path):
    walk, short = Walk(1), Walk(2)
    path = write(tmp_path / 'a.xlsx', {
        'Robot 1': robot(walk, walk.speed(0.345, 15, 'last_interval')),
        'Robot 2': robot(short, short.speed(0.345, 15, 'last_interval'), slice(10))})
    session, _ = import_session(path, Answers())
    assert session.tracks.particles.tolist() == [1, 2]
    step = session.tracks.of(2).position[9] - session.tracks.of(2).position[0]
    assert np.hypot(*step) == pytest.approx(0.345e-6 * abs(short.z[9] - short.z[0]), rel=1e-4)


@pytest.mark.parametrize('degrees', [False, True])
def test_tilt_and_cone_angle_say_the_unit_of_the_direction(tmp_path, degrees):
    walk = Walk()
    alpha = 0.3 * np.sign(walk.alpha)  # a span of 0.6 could be either
    step = 3 * walk.frequency * walk.dt * np.exp(-1j * alpha)
    walk.z = np.cumsum(step)
    scale = 180 / np.pi if degrees else 1.0
    right = np.full(ROWS, 90.0 if degrees else 1.570796)
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(0.3, 5, 'elapsed'))},
                 actions(walk, Alpha=alpha * scale, Gamma=right, Psi=right))
    session, said = import_session(path, Answers())
    direction = np.arctan2(*session.commands.field.T[::-1])
    assert np.abs(direction).tolist() == pytest.approx([0.3] * len(direction))
    assert session.commands.tilt is None
    assert any(f"'Alpha' is in {'degrees' if degrees else 'radians'}, since 'Gamma'" in sentence
               for sentence in said)


@pytest.mark.parametrize('off', [90, -90])
def test_an_axis_of_rotation_is_a_right_angle_off_and_nobody_is_asked(tmp_path, off):
    walk = Walk()
    alpha = (walk.alpha + math.radians(off + 10)) % (2 * np.pi) - np.pi
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(0.3, 5, 'elapsed'))},
                 actions(walk, Alpha=alpha))
    session, said = import_session(path, Answers())
    z = session.commands.field_at(session.tracks.t) @ [1, 1j]
    # The robot rolls 10° beside a right angle to the axis: that is its own.
    left = np.degrees(np.angle(z * np.exp(-1j * walk.alpha)))
    assert left.tolist() == pytest.approx([10] * ROWS)
    assert any('those of the axis of rotation' in sentence for sentence in said)


def test_a_tilt_that_changes_is_kept(tmp_path):
    walk = Walk()
    tilt = np.where(np.arange(ROWS) < 400, 1.570796, 0.0)
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(0.3, 5, 'elapsed'))},
                 actions(walk, Gamma=tilt))
    session, said = import_session(path, Answers())
    assert any('200 rows; kept as tilt_rad' in sentence for sentence in said)
    write_session(tmp_path / 's', session)
    copy = read_session(tmp_path / 's')
    assert set(np.round(copy.commands.tilt, 3)) == {0.0, 1.571}
    assert copy.assumed == tuple(said)
    assert copy.speed_window == SpeedWindow(5, 'elapsed')


@pytest.mark.parametrize(('unit', 'scale', 'told'), [
    (None, 1e-3, 'shares of full scale'), ('_fraction', 1e-3, 'full scale is taken as 1 mT'),
    ('_mT', 1e-3, 'leads'), ('_T', 1.0, 'leads')])
def test_fields_within_one_are_shares_of_full_scale(tmp_path, unit, scale, told):
    walk = Walk()
    columns = robot(walk, walk.speed(0.3, 5, 'elapsed')) | {
        'Bx': 0.5 * np.cos(walk.alpha), 'By': 0.5 * np.sin(walk.alpha)}
    path = write(tmp_path / 'a.xlsx', {'Robot 1': columns})
    session, said = import_session(path, Answers(field_unit=unit))
    assert np.hypot(*session.commands.field.T) == pytest.approx(0.5 * scale)
    assert any(told in sentence for sentence in said)


def test_full_scale_is_stated_and_shares_beyond_it_are_refused(tmp_path):
    walk = Walk()
    columns = robot(walk, walk.speed(0.3, 5, 'elapsed')) | {
        'Bx': np.cos(walk.alpha), 'By': np.sin(walk.alpha)}
    path = write(tmp_path / 'a.xlsx', {'Robot 1': columns})
    session, _ = import_session(path, Answers(full_scale=12e-3))
    assert np.hypot(*session.commands.field.T) == pytest.approx(12e-3)
    path = write(tmp_path / 'b.xlsx', {'Robot 1': columns | {'Bx': 1.5 * np.cos(walk.alpha)}})
    with pytest.raises(InputError, match='from −1 to 1'):
        import_session(path, Answers(field_unit='_fraction'))


def test_neither_field_nor_rotation_is_a_recording_at_rest(tmp_path):
    walk = Walk()
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(0.3, 5, 'elapsed'))},
                 actions(walk, **{'Alpha': np.zeros(ROWS), 'Rolling Frequency': np.zeros(ROWS)}))
    session, said = import_session(path, Answers())
    assert session.commands.frequency.tolist() == [0]
    assert any('no rotation and no field' in sentence for sentence in said)


def test_a_track_that_is_picked_up_again_is_cut(tmp_path):
    walk = Walk()
    columns = robot(walk, walk.speed(0.345, 5, 'elapsed'))
    gone = np.arange(200, 300)
    lost = {name: np.delete(np.asarray(column), gone) for name, column in columns.items()}
    lost['Times'][200] = 0.0
    lost['Pos X'][200:] += 300  # elsewhere
    path = write(tmp_path / 'a.xlsx', {'Robot 1': lost}, actions(walk))
    session, said = import_session(path, Answers())
    assert session.tracks.particles.tolist() == [1, 2]
    first, second = session.tracks.of(1), session.tracks.of(2)
    assert (len(first.t), len(second.t)) == (200, 300)
    gap = second.t[0] - first.t[-1]
    assert gap == pytest.approx(101 * np.median(lost['Times']), rel=0.01)
    assert any('found again in line 202' in sentence for sentence in said)
    assert any('sheet of robot 1 holds robot 2 from' in sentence for sentence in said)
    # Commands are joined by frame, so that they stay beside the motion.
    at = second.t[50] + 1e-6
    assert session.commands.frequency_at(at) == walk.frequency[350]


def test_sheets_that_change_their_robots_are_followed(tmp_path):
    """Robot 1 is deleted from the list at row 300, and the others move up by one sheet."""
    walks = [Walk(seed) for seed in (1, 2, 3)]
    for k, walk in enumerate(walks):
        walk.dt, walk.t = walks[0].dt, walks[0].t
        walk.z = walk.z + 900 * k
    tables = [robot(walk, walk.speed(0.345, 5, 'elapsed')) for walk in walks]
    moved = []
    for k in (0, 1):
        moved.append({name: np.r_[tables[k][name][:300], tables[k + 1][name][300:]]
                      for name in tables[k]})
    last = {name: column[:300] for name, column in tables[2].items()}
    path = write(tmp_path / 'a.xlsx', {
        'Robot 1': moved[0], 'Robot 2': moved[1], 'Robot 3': last})
    session, said = import_session(path, Answers())
    assert session.tracks.particles.tolist() == [1, 2, 3]
    assert [len(session.tracks.of(k).t) for k in (1, 2, 3)] == [300, 600, 600]
    for name, walk in ((2, walks[1]), (3, walks[2])):
        own = session.tracks.of(name).position @ [1, 1j]
        np.testing.assert_allclose(own, 0.345e-6 * walk.z.conj(), rtol=1e-4)
    assert sum('it is at the position of that robot' in sentence for sentence in said) == 2


def test_a_stage_that_moves_changes_no_robot(tmp_path):
    walks = [Walk(seed) for seed in (1, 2)]
    for walk in walks:
        walk.dt, walk.t = walks[0].dt, walks[0].t
        walk.z[300:] += 400 + 100j
    path = write(tmp_path / 'a.xlsx', {
        f'Robot {k}': robot(walk, walk.speed(0.345, 5, 'elapsed'))
        for k, walk in enumerate(walks, 1)})
    session, _ = import_session(path, Answers())
    assert session.tracks.particles.tolist() == [1, 2]


def recordings() -> list[Path]:
    return sorted(SHARED.glob('*/*.xlsx'))


@pytest.mark.skipif(not recordings(), reason='the shared recordings are not here')
@pytest.mark.parametrize('number', [
    pytest.param(number, marks=[pytest.mark.soak] * (number % 4 > 0)) for number in range(12)])
def test_every_shared_recording_is_imported_right_without_an_option(number):
    """The pixel size by an independent reading of each sheet: |v| · 15 dt over the displacement
    in 15 frames, in every row of every robot."""
    assert len(recordings()) == 12
    session, said = import_session(recordings()[number], Answers())
    book = openpyxl.load_workbook(recordings()[number], read_only=True, data_only=True)
    sizes = []
    for page in book.worksheets[1:]:
        rows = np.array([row[1:7] for row in page.iter_rows(min_row=2, values_only=True)], float)
        moved = np.hypot(*(rows[15:, 1:3] - rows[:-15, 1:3]).T)
        sizes.append(rows[15:, 5] * 15 * rows[15:, 0] / np.maximum(moved, 1e-9))
    book.close()
    by_hand = np.median(np.concatenate(sizes))
    assert session.conditions.pixel_size * 1e6 == pytest.approx(by_hand, rel=1e-3)
    assert any('pixels of' in sentence for sentence in said)
    assert any('y points down' in sentence for sentence in said)


@pytest.mark.parametrize(('rows', 'what'), [(slice(400), 'begin'), (slice(200, None), 'end')])
def test_counters_that_differ_are_tied_by_the_motion(tmp_path, rows, what):
    walk = Walk(3)
    table = robot(walk, walk.speed(0.345, 5, 'elapsed'), rows, first=9000)
    path = write(tmp_path / 'a.xlsx', {'Robot 1': table}, actions(walk))
    session, said = import_session(path, Answers())
    assert any(f'the two {what} together' in sentence for sentence in said)
    at = session.tracks.t + 1e-6
    assert session.commands.frequency_at(at).tolist() == walk.frequency[rows].tolist()


def test_counters_that_differ_are_refused_where_nothing_moves_as_told(tmp_path):
    walk = Walk(3)
    table = robot(walk, walk.speed(0.345, 5, 'elapsed'), slice(400), first=9000)
    random = np.random.default_rng(0).uniform(-3, 3, ROWS)
    path = write(tmp_path / 'a.xlsx', {'Robot 1': table}, actions(walk, Alpha=random))
    with pytest.raises(InputError, match='expected frames 9000 to 9399'):
        import_session(path, Answers())


def test_no_interval_precedes_the_first_row(tmp_path):
    walk = Walk()
    walk.dt[0] = np.nan
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(0.3, 5, 'frames'))},
                 actions(walk))
    session, _ = import_session(path, Answers())
    assert np.diff(session.tracks.t).tolist() == pytest.approx(walk.dt[1:].tolist())
