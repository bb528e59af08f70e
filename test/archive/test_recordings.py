"""What is a recording is told by what files hold; what can't be read is listed with a reason."""

import datetime
import errno
import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import openpyxl
import pytest

from microbot_ros.archive.labels import labels_of
from microbot_ros.archive.recordings import (
    MARK,
    FileCards,
    Found,
    Refused,
    content_of,
    find,
)
from microbot_ros.common.errors import InputError

DATA = Path(__file__).parents[1] / 'data'
TABLE = 'time (s);x (um);y (um)\n0;1;2\n0,1;1;2\n0,2;1;3\n'


def film(path, frames=3):
    # FFmpeg goes by the ending, and so do people until they rename.
    video = path.with_suffix('.avi')
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*'MJPG'), 10, (64, 48))
    for k in range(frames):
        writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
    writer.release()
    video.rename(path)


def workbook(path):
    book = openpyxl.Workbook()
    for row in (('t (s)', 'x (um)', 'y (um)'), (0, 1, 2), (1, 2, 3)):
        book.active.append(row)
    book.save(path.with_suffix('.xlsx'))
    path.with_suffix('.xlsx').rename(path)


def look(*folders):
    found = list(find(folders, FileCards({})))
    return ({one.name: one for one in found if isinstance(one, Found)},
            {one.name: one.reason for one in found if isinstance(one, Refused)})


@pytest.fixture
def shelf(tmp_path):
    shelf = tmp_path / 'shelf'
    (shelf / 'pictures').mkdir(parents=True)
    (shelf / 'robots').mkdir()
    film(shelf / 'film.dat')
    workbook(shelf / 'book.bak')
    shutil.copy(DATA / 'tracking.mcap', shelf / 'log.bin')
    (shelf / 'table.txt').write_text(TABLE)
    for k in range(3):
        cv2.imwrite(str(shelf / 'pictures' / f'{k}.png'), np.zeros((8, 8), np.uint8))
    for name, text in (('one', TABLE), ('two', TABLE),
                       ('field', 'time (s);bx (mT);by (mT)\n0;1;2\n1;0;2\n')):
        (shelf / 'robots' / f'{name}.csv').write_text(text)
    (shelf / 'notes.md').write_text('# notes\nnothing here\n')
    return shelf


def test_kinds_by_content_whatever_the_name(shelf):
    found, refused = look(shelf)
    assert {name: one.kind for name, one in found.items()} == {
        'shelf/film.dat': 'film', 'shelf/book.bak': 'table', 'shelf/log.bin': 'recording',
        'shelf/table.txt': 'table', 'shelf/pictures': 'film', 'shelf/robots': 'table'}
    assert len(found['shelf/robots'].files) == len(found['shelf/pictures'].files) == 3
    assert refused == {}


def test_what_claims_to_be_one_and_is_none_is_named(shelf):
    (shelf / 'empty.csv').write_bytes(b'')
    (shelf / 'bag.db3').write_bytes(b'SQLite format 3\0' + bytes(100))
    (shelf / 'cut.mcap').write_bytes(bytes(100))
    (shelf / 'money.csv').write_text('item,price\nfield,3\n')
    (shelf / 'gone.mp4').symlink_to(shelf / 'nowhere.mp4')
    (shelf / 'secret.csv').write_bytes(b'\xff\xfe\x80,\x81\n')
    _, refused = look(shelf)
    assert {*refused} == {f'shelf/{name}' for name in (
        'empty.csv', 'bag.db3', 'cut.mcap', 'money.csv', 'secret.csv')}
    assert 'MCAP' in refused['shelf/bag.db3']
    assert 'it has none' in refused['shelf/money.csv']


def test_names_that_are_no_text_are_refused_and_stop_nothing(tmp_path):
    """As on disks of old systems: b'Messung_\xe4' is Latin-1."""
    for name in (b'Messung_\xe4.csv', b'Tag_\xe4/t.csv'):
        path = Path(os.fsdecode(os.fsencode(tmp_path) + b'/lab/' + name))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(TABLE)
    (tmp_path / 'lab' / 'Größe.csv').write_text(TABLE)
    found, refused = look(tmp_path / 'lab')
    assert [*found] == ['lab/Größe.csv']
    assert len(refused) == 2
    assert {*refused.values()} == {'expected a name in UTF-8; rename it'}
    assert all('Messung_' in name or 'Tag_' in name for name in refused)
    json.dumps([*refused], ensure_ascii=False).encode()


@pytest.mark.parametrize('shut', [['scandir'], ['scandir', 'stat']], ids=['listing', 'entry'])
def test_a_folder_that_is_closed_is_refused_and_stops_nothing(shelf, monkeypatch, shut):
    """Root may look into any folder, so that this one is closed by hand."""
    closed = shelf / 'colleague'
    closed.mkdir()

    def refusing(function, inside):
        def instead(path, *rest, **options):
            if inside in (Path(path), Path(path).parent):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
            return function(path, *rest, **options)
        return instead

    for name, inside in (('scandir', closed), ('stat', closed / MARK)):
        if name in shut:
            monkeypatch.setattr(os, name, refusing(getattr(os, name), inside))
    found, refused = look(shelf)
    assert len(found) == 6
    assert refused == {'shelf/colleague': 'Permission denied'}


def test_locks_of_excel_are_hidden_and_old_books_are_named(shelf):
    for name in ('~$book.xlsx', '._book.xlsx'):
        (shelf / name).write_bytes(b'\3Max' + bytes(161))
    (shelf / 'old.xls').write_bytes(b'\xd0\xcf\x11\xe0' + bytes(600))
    (shelf / 'export.txt').write_bytes(TABLE.encode('utf-16'))
    found, refused = look(shelf)
    assert refused == {'shelf/old.xls': 'expected .xlsx; save the file in that format'}
    assert found['shelf/export.txt'].kind == 'table'


def test_a_session_keeps_what_belongs_to_it(laboratory):
    found, refused = look(laboratory)
    assert len(found) == 6
    assert refused == {}
    session = found['laboratory/day-0/s0']
    assert session.kind == 'session'
    assert {file.name for file in session.files} == {'tracks.csv', 'commands.csv', 'session.yaml'}


@pytest.mark.parametrize(('text', 'beside', 'kind'), [
    (TABLE, (), 'table'), (TABLE, ('session.yaml',), 'session'),
    ('\ufefft_s, particle,x_um,y_um\n0,0,1,1\n', (), 'session')])
def test_a_table_of_an_instrument_may_have_the_name_of_a_session(tmp_path, text, beside, kind):
    for name, content in (('tracks.csv', text), *((name, '') for name in beside)):
        (tmp_path / name).write_text(content)
    found, refused = look(tmp_path)
    assert [one.kind for one in found.values()] == [kind]
    assert refused == {}


def test_an_archive_within_is_not_looked_at_unless_asked_for(shelf):
    (shelf / 'archive' / MARK).mkdir(parents=True)
    (shelf / 'archive' / 'sessions').mkdir()
    (shelf / 'archive' / 'sessions' / 'x.csv').write_text(TABLE)
    assert 'shelf/archive/sessions/x.csv' not in look(shelf)[0]
    assert [*look(shelf / 'archive')[0]] == ['archive/sessions/x.csv']


def test_folders_that_overlap_are_looked_at_once(shelf):
    both = [one.path for one in find([shelf, shelf / 'pictures'], FileCards({}))]
    assert len(both) == len(set(both)) == 6


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match='expected a folder of recordings'):
        look(tmp_path / 'nowhere')


def test_content_is_the_same_wherever_it_lies(laboratory, tmp_path):
    cards = FileCards({})
    shutil.copytree(laboratory, tmp_path / 'copy')
    one, other = (look(folder)[0] for folder in (laboratory, tmp_path / 'copy'))
    first = content_of(one['laboratory/day-1/s1'], cards)
    assert content_of(other['copy/day-1/s1'], cards) == first
    assert content_of(one['laboratory/day-2/s2'], cards) != first
    file = laboratory / 'day-1' / 's1' / 'commands.csv'
    file.write_text(file.read_text() + '99.0,0.0,0.0\n')
    assert content_of(one['laboratory/day-1/s1'], cards) != first


def test_a_file_is_read_again_only_when_it_changed(laboratory):
    cards = FileCards({})
    found = look(laboratory)[0]['laboratory/day-0/s0']
    first = content_of(found, cards)
    for card in cards.known.values():
        card[3] = card[3] and 'kept'
    assert content_of(found, cards) != first
    for file in found.files:
        file.touch()
    assert content_of(found, cards) == first


def test_labels_come_from_the_nearest_file_and_days_from_names(tmp_path):
    place = tmp_path / 'lab' / '2026-03-14 rig A' / 'late'
    place.mkdir(parents=True)
    (place / 't.csv').write_text(TABLE)
    (tmp_path / 'lab' / 'archive.yaml').write_text('rig: A\nbatch: 7\n')
    (place / 'archive.yaml').write_text('batch: eight\n')
    # Above what was asked for nobody looks.
    (tmp_path / 'archive.yaml').write_text('rig: B\n')
    found = look(tmp_path / 'lab')[0]['lab/2026-03-14 rig A/late/t.csv']
    labels = labels_of(found)
    assert (labels.rig, labels.batch) == ('A', 'eight')
    assert labels.day == datetime.date(2026, 3, 14)
    (place / 'archive.yaml').write_text('recorded: 2025-01-02\n')
    labels = labels_of(found)
    assert labels.batch == '7'
    assert labels.day == datetime.date(2025, 1, 2)
    (place / 'archive.yaml').write_text('bench: 3\n')
    with pytest.raises(InputError, match=r"archive.yaml:1: unknown key 'bench'"):
        labels_of(found)


@pytest.mark.parametrize(('name', 'day'), [
    ('lab/20260230/x', None), ('lab/2026-02-28_x', (2026, 2, 28)), ('x120260228', None),
    ('2025_01_01/2026.01.02.csv', (2026, 1, 2))])
def test_days_in_names(name, day):
    found = Found(Path('/top') / name, 'table', Path('/top'), ())
    assert labels_of(found).day == (day and datetime.date(*day))
