"""Workbooks and texts as people leave them: each is imported right or refused by one line."""

import math
import zipfile

import numpy as np
import openpyxl
import pytest
from test_table_scale import ROWS, Walk, actions, robot, write

from microbot_ros.common.errors import InputError
from microbot_ros.session.spreadsheets.assemble import import_session
from microbot_ros.session.spreadsheets.sheets import Answers
from microbot_ros.session.spreadsheets.summary import SummaryError

PIXEL = 0.345


@pytest.fixture(scope='module')
def walk() -> Walk:
    return Walk(3)


def book(path, walk, edit=lambda _: None):
    """A workbook of one robot, changed by hand."""
    write(path, {'Robot 1': robot(walk, walk.speed(PIXEL, 15, 'last_interval'))}, actions(walk))
    pages = openpyxl.load_workbook(path)
    edit(pages)
    pages.save(path)
    return path


def text(path, walk, mark=',', point='.', quote='', encoding='utf-8', head=(), **changed):
    columns = {'Time (s)': walk.t, 'X (px)': walk.z.real, 'Y (px)': walk.z.imag,
               'Vel Mag (µm/s)': walk.speed(PIXEL, 15, 'elapsed'), 'Alpha (rad)': walk.alpha,
               'Rolling Frequency': walk.frequency} | changed
    cells = [list(columns), *zip(*columns.values(), strict=True)]
    lines = (mark.join(f'{quote}{str(cell).replace(".", point)}{quote}' for cell in row)
             for row in cells)
    path.write_bytes('\n'.join([*head, *lines, '']).encode(encoding))
    return path


def check(session, walk, robots=1) -> None:
    """Scale, times and commands of the first robot are those of the walk."""
    assert len(session.tracks.particles) == robots
    own = session.tracks.of(session.tracks.particles[0])
    z = own.position @ np.array([1e6, 1e6j])
    assert len(z) == ROWS
    np.testing.assert_allclose(z - z[0], PIXEL * (walk.z - walk.z[0]).conj(), atol=0.05)
    # No interval tells when the first row was.
    np.testing.assert_allclose(own.t - own.t[0], walk.t - walk.t[0], atol=2e-3)
    later = session.commands.t[1:] - own.t[0]
    changed = walk.t[1:][np.diff(walk.alpha) != 0] - walk.t[0]
    np.testing.assert_allclose(later, changed, atol=2e-3)
    z = session.commands.field @ np.array([1, 1j])
    np.testing.assert_allclose(np.angle(z[1:] / np.exp(1j * walk.alpha[40::40])), 0, atol=1e-6)


def notes(pages):
    pages['Robot 1'].append([])
    pages['Robot 1'].append(['mean', None, None, None, 12.3])


def heading_lines(pages):
    page = pages['Robot 1']
    page.insert_rows(1, 3)
    for k, row in enumerate((('Operator', 'Max'), ('Date', '12.03.2024')), 1):
        for column, cell in enumerate(row, 1):
            page.cell(k, column, cell)


def results(pages):
    page = pages.create_sheet('Plot')
    for row in (('x', 'y'), (1, 2.0), (2, 3.0)):
        page.append(row)


def few_rows(pages):
    """A robot that was seen for three frames: its intervals happen to ascend."""
    page = pages.create_sheet('Robot 2')
    page.append(('Frame', 'Times', 'Pos X', 'Pos Y', 'Vel Mag'))
    for k, interval in enumerate((0.030, 0.035, 0.041)):
        page.append((100 + k, interval, 50.0 + k, 60.0, 0.0))


def decimal_commas(pages):
    for row in pages['Robot 1'].iter_rows(min_row=2):
        for cell in row:
            cell.value = str(cell.value).replace('.', ',')


@pytest.mark.parametrize(('edit', 'robots', 'said'), [
    (notes, 1, 'Robot 1: line 603 below the table hold notes; left out'),
    (heading_lines, 1, ''), (few_rows, 2, 'all robots on the clock of Robot 1'),
    (results, 1, 'Plot: holds neither positions at times nor commands; left out'),
    (decimal_commas, 1, 'Robot 1: decimal commas'),
])
def test_a_workbook_with_traces_of_people_is_imported_right(tmp_path, walk, edit, robots, said):
    session, told = import_session(book(tmp_path / 'a.xlsx', walk, edit), Answers())
    check(session, walk, robots)
    assert said in ' '.join(told)


def test_errors_of_excel_are_blank_cells(tmp_path, walk):
    def errors(pages):
        for k in range(300, 303):
            pages['Robot 1'].cell(k, 3, '#N/A')

    session, told = import_session(book(tmp_path / 'a.xlsx', walk, errors), Answers())
    assert len(session.tracks.t) == ROWS - 3
    assert '3 rows without a position are gaps' in told


@pytest.mark.parametrize('how', [
    {}, {'mark': ';', 'point': ','}, {'quote': '"'}, {'quote': '"', 'point': ','},
    {'encoding': 'cp1252'}, {'encoding': 'utf-16', 'mark': '\t'},
    {'head': ('# microscope 2, 12 March', '# pixel 0.345')},
    {'head': ('sep=;',), 'mark': ';', 'point': ','},
])
def test_texts_of_any_program_are_imported_right(tmp_path, walk, how):
    session, told = import_session(text(tmp_path / 'a.csv', walk, **how), Answers())
    check(session, walk)
    assert ('a.csv: not in UTF-8; read as Windows-1252' in told) == ('cp1252' in how.values())


def test_an_angle_beside_a_frequency_is_a_command(tmp_path, walk):
    path = write(tmp_path / 'a.xlsx', {'Robot 1': robot(walk, walk.speed(PIXEL, 15, 'elapsed'))}, {
        'Frame': 100 + np.arange(ROWS), 'Heading Angle (deg)': np.degrees(walk.alpha),
        'Frequency [Hz]': walk.frequency})
    check(import_session(path, Answers())[0], walk)


@pytest.mark.parametrize('rows', [ROWS, 200])
def test_a_gradient_is_no_field_and_sound_is_named(tmp_path, walk, rows):
    """Coils that oppose each other pull; their shares of full scale are no field."""
    on = (np.arange(ROWS) < rows).astype(int)
    path = write(tmp_path / 'a.xlsx', {
        'Robot 1': robot(walk, walk.speed(PIXEL, 15, 'last_interval'))}, actions(
            walk, Bx=0.8 * np.cos(walk.alpha), By=0.8 * np.sin(walk.alpha),
            **{'Rolling Frequency': 0 * walk.t, 'Gradient?': on,
               'Acoustic Frequency': 1e6 * on}))
    session, told = import_session(path, Answers())
    said = ' '.join(told)
    assert f'a gradient in {rows} of {ROWS} rows; no field is imported there' in said
    assert f"'Acoustic Frequency': sound drives the robots in {rows} of {ROWS} rows" in said
    field = session.commands.field_at(session.tracks.t[:rows] - 1e-6)
    if rows == ROWS:
        assert session.commands.frequency is not None
        assert not session.commands.frequency.any()
    else:
        assert not np.nan_to_num(field).any()


def test_commands_that_end_early_are_said_to_be_held(tmp_path, walk):
    field = {name: column[:500] for name, column in actions(walk).items()}
    path = write(tmp_path / 'a.xlsx', {
        'Robot 1': robot(walk, walk.speed(PIXEL, 15, 'last_interval'))}, field)
    told = import_session(path, Answers())[1]
    ends = walk.t[-1] - walk.t[499]
    assert f'Magnetic Field Actions: ends {ends:.1f} s before the tracks; the last command is ' \
           'held' in told


def test_recordings_of_different_commands_are_not_taken_for_one(tmp_path, walk):
    text(tmp_path / 'mon.csv', walk)
    text(tmp_path / 'tue.csv', Walk(4))
    with pytest.raises(InputError, match=r"tue.csv: expected 'Alpha \(rad\)' as in mon at the"):
        import_session(tmp_path, Answers())
    text(tmp_path / 'tue.csv', walk)
    assert len(import_session(tmp_path, Answers())[0].tracks.particles) == 2


def test_two_tables_of_commands_are_refused(tmp_path, walk):
    def twice(pages):
        pages.copy_worksheet(pages['Magnetic Field Actions'])

    with pytest.raises(InputError, match='one table of commands, found a second'):
        import_session(book(tmp_path / 'a.xlsx', walk, twice), Answers())


def test_rows_beyond_the_stated_size_of_a_sheet_are_read(tmp_path):
    """Some programs state fewer rows and columns than they write."""
    path, short = tmp_path / 'whole.xlsx', tmp_path / 'a.xlsx'
    t = np.arange(50) / 20
    write(path, {'Robot 1': {'t_s': t, 'x_um': 10 * t, 'y_um': 0 * t}})
    with zipfile.ZipFile(path) as whole, zipfile.ZipFile(short, 'w') as stated:
        for name in whole.namelist():
            stated.writestr(name, whole.read(name).replace(b'ref="A1:C51"', b'ref="A1:B20"'))
    assert b'<dimension ref="A1:B20"' in zipfile.ZipFile(short).read('xl/worksheets/sheet1.xml')
    tracks = import_session(short, Answers())[0].tracks
    assert tracks.t.tolist() == t.tolist()
    np.testing.assert_allclose(tracks.position[:, 0], 1e-5 * t)


@pytest.mark.parametrize('damage', ['cut', 'flip', 'xml', 'lock', 'text', 'empty'])
def test_damaged_workbooks_are_refused_by_one_line(tmp_path, walk, damage):
    path = book(tmp_path / 'a.xlsx', walk)
    content = bytearray(path.read_bytes())
    if damage == 'xml':
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(path, 'w') as archive:
            for name, part in parts.items():
                archive.writestr(name, part[:3000] if 'sheet1' in name else part)
    elif damage == 'flip':
        content[1000:1040] = bytes(x ^ 0x55 for x in content[1000:1040])
        path.write_bytes(content)
    else:
        path.write_bytes({'cut': content[:len(content) // 2], 'lock': b'\x03Max' + bytes(161),
                          'text': b'x,y\n1,2\n', 'empty': b''}[damage])
    with pytest.raises(InputError, match=r'a.xlsx: expected an .xlsx spreadsheet; the file is'):
        import_session(path, Answers())


@pytest.mark.parametrize(('columns', 'count'), [
    ({'freq': range(1, 21), 'robot 1': range(20), 'robot 2': range(20)}, '2 columns'),
    ({'Frequency (Hz)': range(1, 21), 'velocity': range(20)}, '1 column'),
    ({'freq': range(1, 21), 'mean speed': range(20), 'std': range(20)}, '2 columns'),
    ({'freq': [*range(1, 11)] * 2, 'Robot': [1] * 10 + [2] * 10, 'Average Velocity': range(20)},
     '1 column'),
])
def test_results_against_a_frequency_are_averages_by_whatever_name(tmp_path, columns, count):
    path = write(tmp_path / 'a.xlsx', {'Sheet1': {k: list(v) for k, v in columns.items()}})
    with pytest.raises(SummaryError, match=f'a summary of {count} of averages against'):
        import_session(path, Answers())


def test_a_table_of_numbers_is_not_cut_where_a_robot_is_lost(tmp_path, walk):
    """Rows of a lost robot at the end keep frame and time; they are gaps, not notes."""
    own = robot(walk, walk.speed(PIXEL, 15, 'last_interval'))
    for name in ('Pos X', 'Pos Y'):
        own[name] = own[name].copy()
        own[name][-50:] = math.nan
    told = import_session(write(tmp_path / 'a.xlsx', {'Robot 1': own}, actions(walk)),
                          Answers())[1]
    assert '50 rows without a position are gaps' in told
    assert not any('notes' in sentence for sentence in told)
