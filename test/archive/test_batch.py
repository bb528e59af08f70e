"""A run over an archive: each done once, what is wrong named, whatever stops it."""

import errno
import io
import json
import os
import re
import shutil
from unittest import mock

import duckdb
import numpy as np
import openpyxl
import polars
import pytest
from command_line import microbot
from laboratories import fill, write_film
from rich.console import Console

from microbot_ros.archive import Archive, batch, conclude, read_table, work
from microbot_ros.archive.cluster import ClusterError
from microbot_ros.cli.batch import _Shown
from microbot_ros.common.errors import InputError
from microbot_ros.session import read_session
from microbot_ros.session.spreadsheets.sheets import Answers

pytestmark = pytest.mark.usefixtures('serial')

TABLE = 'time (s);x (um);y (um)\n' + ''.join(f'{k / 10};{k};{2 * k}\n' for k in range(20))
SPOTS = np.arange(30)[:, None, None] * np.array([1, 0]) + np.array([[40, 40], [60, 80]])
"""Places (30, 2, 2) [px] of two that go right by one pixel a frame."""


def settings(task):
    answers = vars(Answers())
    return {'fit': {'exposure_s': 0.0, 'answers': answers}, 'discover': {'answers': answers},
            'import': {'answers': answers},
            'track': {'pixel_size_um': None, 'frame_rate_hz': None, 'tracker': {}}}[task]


def run(task, folder, out):
    return batch.run_batch(task, [folder], out, settings(task))


@pytest.fixture
def tables(tmp_path):
    folder = tmp_path / 'tables'
    folder.mkdir()
    for k in range(5):
        (folder / f't{k}.csv').write_text(TABLE + f'2.0;{k};0\n')
    return folder


def test_nothing_is_done_twice(laboratory, tmp_path, serial):
    out = tmp_path / 'out'
    first, found = run('fit', laboratory, out)
    assert (first.found, first.done, first.kept) == (6, 6, 0)
    assert found['sessions'] == 6
    written = {path: path.stat().st_mtime_ns for path in out.rglob('*') if path.suffix == '.json'
               and path.name not in ('recordings.json',)}
    second, again = run('fit', laboratory, out)
    assert (second.done, second.kept) == (0, 6)
    assert again == found
    assert len(serial.done) == 6
    assert {path: path.stat().st_mtime_ns for path in written} == written


def test_what_changed_is_done_again_and_what_is_gone_is_gone(laboratory, tmp_path):
    out = tmp_path / 'out'
    run('fit', laboratory, out)
    changed = laboratory / 'day-0' / 's0' / 'session.yaml'
    changed.write_text(changed.read_text().replace('radius_um: 4.6', 'radius_um: 2.3'))
    shutil.rmtree(laboratory / 'day-1' / 's1')
    before = read_table(out).to_pandas()
    summary, found = run('fit', laboratory, out)
    assert (summary.done, summary.kept, found['sessions']) == (1, 4, 5)
    after = read_table(out).to_pandas()
    force = [rows[rows.session == 'laboratory/day-0/s0'].force_pN.iloc[0]
             for rows in (before, after)]
    assert force[1] == pytest.approx(force[0] / 2)
    assert 'laboratory/day-1/s1' not in set(after.session)


def test_another_setting_is_another_result(laboratory, tmp_path):
    run('fit', laboratory, tmp_path / 'out')
    other = settings('fit') | {'exposure_s': 0.05}
    summary, _ = batch.run_batch('fit', [laboratory], tmp_path / 'out', other)
    assert summary.done == 6


def test_copies_are_done_and_counted_once(laboratory, tmp_path):
    shutil.copytree(laboratory / 'day-0' / 's0', laboratory / 'backup')
    summary, found = run('fit', laboratory, tmp_path / 'out')
    assert (summary.found, summary.done, len(summary.copy_of), found['sessions']) == (7, 6, 1, 6)
    assert {*summary.copy_of, *summary.copy_of.values()} == {
        'laboratory/backup', 'laboratory/day-0/s0'}


def test_what_is_wrong_is_listed_and_stops_nothing(laboratory, tmp_path, serial):
    tracks = laboratory / 'day-0' / 's0' / 'tracks.csv'
    tracks.write_text(tracks.read_text().replace('0.05,', 'soon,', 1))
    (laboratory / 'bad.csv').write_text('a,b\n1,2\n')
    summary, found = run('fit', laboratory, tmp_path / 'out')
    assert found['sessions'] == 5
    assert summary.refused['laboratory/day-0/s0'].startswith('tracks.csv:4: expected a number')
    assert 'laboratory/bad.csv' in summary.refused
    assert (summary.found, summary.done, len(summary.refused)) == (7, 5, 2)
    assert 'tracks.csv:4' in (tmp_path / 'out' / 'archive.html').read_text()
    assert run('fit', laboratory, tmp_path / 'out')[0].refused == summary.refused
    assert len(serial.done) == 6


@pytest.mark.parametrize('stop', [KeyboardInterrupt(), ClusterError('gone')])
def test_what_was_done_before_a_stop_stays_and_the_next_run_goes_on(
        laboratory, tmp_path, serial, stop):
    out = tmp_path / 'out'
    serial.stop_after = (4, stop)
    with pytest.raises(type(stop)):
        run('fit', laboratory, out)
    assert len(set(read_table(out).to_pandas().session)) == 4
    serial.stop_after = None
    summary, _ = run('fit', laboratory, out)
    assert (summary.done, summary.kept) == (2, 4)
    assert len({job.key for job in serial.done}) == len(serial.done) == 6


def test_a_failure_is_told_and_tried_again(tables, tmp_path):
    def fails(_, jobs, report):
        for job in jobs:
            report(job, 'ValueError: no')

    with mock.patch.object(batch, 'run_jobs', fails):
        summary, _ = run('import', tables, tmp_path / 'out')
    assert summary.failed == {f'tables/t{k}.csv': 'ValueError: no' for k in range(5)}
    assert (summary.done, summary.kept) == (0, 0)
    assert run('import', tables, tmp_path / 'out')[0].done == 5


def test_tables_become_sessions_that_can_be_fitted(tables, tmp_path):
    (tables / 'archive.yaml').write_text('rig: left\nrecorded: 2026-03-14\n')
    out = tmp_path / 'out'
    run('import', tables, out)
    sessions = sorted((out / 'sessions').iterdir())
    assert len(sessions) == 5
    assert len(read_session(sessions[0]).tracks.t) == 21
    _, found = run('fit', out / 'sessions', out)
    assert found['quantities']['diffusion_um2_s']['by']['rig']['left']['count'] == 5
    assert set(map(str, read_table(out).to_pandas().day)) == {'2026-03-14'}
    # The tables themselves are the same data once more only if they are asked for.
    assert found['sessions'] == 5


def imported_with(pixel_size, folder, out):
    """Summary and positions [px] of the only session, after an import with this pixel size."""
    answers = vars(Answers(pixel_size=pixel_size))
    summary, _ = batch.run_batch('import', [folder], out, {'answers': answers})
    [made] = (out / 'sessions').iterdir()
    session = read_session(made)
    assert session.conditions.pixel_size == pixel_size
    return summary, session.tracks.position[-1, 0] / pixel_size


def test_a_session_has_the_settings_of_the_last_run(tmp_path):
    folder, out = tmp_path / 'tables', tmp_path / 'out'
    folder.mkdir()
    (folder / 'a.csv').write_text(TABLE.replace('um', 'px'))
    for size in (0.25e-6, 0.5e-6, 0.25e-6):
        summary, at = imported_with(size, folder, out)
        assert (summary.done, summary.kept, at) == (1, 0, 19)
    summary, at = imported_with(0.25e-6, folder, out)
    assert (summary.done, summary.kept, at) == (0, 1, 19)


def test_a_session_that_was_deleted_is_made_again(tables, tmp_path):
    out = tmp_path / 'out'
    run('import', tables, out)
    gone = sorted((out / 'sessions').iterdir())[2]
    shutil.rmtree(gone)
    summary, found = run('import', tables, out)
    assert (summary.done, summary.kept, found['imported']['sessions']) == (1, 4, 5)
    assert len(read_session(gone).tracks.t) == 21


@pytest.mark.parametrize('table', ['run.txt', 'run.tsv'])
def test_tables_that_differ_in_their_ending_are_imported_together(tmp_path, table):
    (tmp_path / 'col').mkdir()
    (tmp_path / 'col' / 'run.csv').write_text(TABLE)
    (tmp_path / 'col' / table).write_text('time (s);bx (mT);by (mT)\n0;5;0\n1;0;5\n')
    summary, _ = run('import', tmp_path / 'col', tmp_path / 'out')
    assert summary.refused == {}
    [made] = (tmp_path / 'out' / 'sessions').iterdir()
    session = read_session(made)
    assert (len(session.tracks.t), len(session.commands.t)) == (20, 2)


def test_a_folder_of_robots_and_a_renamed_book_are_imported(tmp_path):
    folder = tmp_path / 'mixed'
    (folder / 'robots').mkdir(parents=True)
    for k in range(2):
        (folder / 'robots' / f'robot{k}.txt').write_text(TABLE)
    (folder / 'robots' / 'field.txt').write_text('time (s);bx (mT);by (mT)\n0;5;0\n1;0;5\n')
    book = openpyxl.Workbook()
    for row in (('t (s)', 'x (um)', 'y (um)'), (0, 1, 2), (1, 2, 3)):
        book.active.append(row)
    book.save(folder / 'x.xlsx')
    (folder / 'x.xlsx').rename(folder / 'book.old')
    run('import', folder, tmp_path / 'out')
    robots, book = (read_session(next((tmp_path / 'out' / 'sessions').glob(f'{name}-*')))
                    for name in ('robots', 'book'))
    assert (len(robots.tracks.particles), len(robots.commands.t)) == (2, 2)
    assert len(book.tracks.t) == 2


def test_films_become_sessions(tmp_path):
    place = tmp_path / 'films' / 'monday'
    place.mkdir(parents=True)
    write_film(place / 'film.avi', SPOTS)
    (place / 'session.yaml').write_text('pixel_size_um: 0.5\nradius_um: 2\n')
    (place / 'commands.csv').write_text('t_s,bx_mT,by_mT\n0,5,0\n')
    run('track', tmp_path / 'films', tmp_path / 'out')
    [made] = (tmp_path / 'out' / 'sessions').iterdir()
    session = read_session(made)
    assert len(session.tracks.particles) == 2
    assert len(np.unique(session.tracks.t)) == 30
    assert session.conditions.radius == 2e-6
    assert len(session.commands.t) == 1
    step = session.tracks.of(int(session.tracks.particles[0])).position
    # One pixel a frame, to the right: half a micrometre.
    assert np.diff(step[:, 0]).mean() == pytest.approx(0.5e-6, rel=0.02)


def test_what_is_corrected_beside_a_film_reaches_its_session(tmp_path):
    place, out = tmp_path / 'films', tmp_path / 'out'
    place.mkdir()
    write_film(place / 'film.avi', SPOTS[:10])
    for size, row in ((0.5, '0,5,0'), (0.25, '0,5,0'), (0.25, '0,0,7')):
        (place / 'session.yaml').write_text(f'pixel_size_um: {size}\n')
        (place / 'commands.csv').write_text(f't_s,bx_mT,by_mT\n{row}\n')
        run('track', place, out)
        [made] = (out / 'sessions').iterdir()
        session = read_session(made)
        assert session.conditions.pixel_size == pytest.approx(size * 1e-6)
        assert np.ptp(session.tracks.position[:, 1]) == pytest.approx(40 * size * 1e-6, rel=0.02)
        field = np.array([row.split(',')[1:]], float) * 1e-3
        np.testing.assert_allclose(session.commands.field, field)


def test_a_film_is_tracked_as_microbot_track_does(tmp_path):
    (tmp_path / 'films').mkdir()
    write_film(tmp_path / 'films' / 'film.avi', SPOTS)
    run('track', tmp_path / 'films', tmp_path / 'out')
    [made] = (tmp_path / 'out' / 'sessions').iterdir()
    assert microbot('track', tmp_path / 'films' / 'film.avi', '--out', tmp_path / 'alone',
                    '--no-overlay') == 0
    assert (made / 'tracks.csv').read_text() == (tmp_path / 'alone' / 'tracks.csv').read_text()


def test_one_table_for_pandas_polars_and_duckdb(tmp_path):
    out = tmp_path / 'out'
    run('discover', fill(tmp_path / 'laboratory', 2), out)
    file = str(out / 'archive.parquet')
    frame = read_table(out).to_pandas()
    assert len(frame) == 4
    assert polars.read_parquet(file)['v_um_s'].to_list() == frame.v_um_s.tolist()
    [(count, mean)] = duckdb.sql(
        f"select count(*), avg(v_um_s) from '{file}' where verdict = 'consistent'").fetchall()
    assert (count, mean) == (4, pytest.approx(frame.v_um_s.mean()))
    assert (frame.v_um_s_low_95 < frame.v_um_s).all()
    assert (frame.v_um_s < frame.v_um_s_high_95).all()
    assert frame.v_um_s.mean() == pytest.approx(5.0, abs=0.3)
    assert conclude(out).quantities[0].spread.mean == pytest.approx(5.0, abs=0.3)
    reports = sorted(path.relative_to(out) for path in (out / 'reports').glob('*.html'))
    assert len(reports) == 2
    page = (out / 'archive.html').read_text()
    assert all(f'href="{path}"' in page for path in reports)
    headings = re.findall(r'<h2>(.*?)</h2>', page)
    assert 'Reports of the sessions' in headings
    assert len(headings) == len(set(headings))  # no section twice


def test_two_runs_into_one_archive(laboratory, tmp_path):
    archive = Archive(tmp_path / 'out')
    with archive.locked(), pytest.raises(InputError, match=f'another run .*process {os.getpid()}'):
        run('fit', laboratory, tmp_path / 'out')
    assert run('fit', laboratory, tmp_path / 'out')[0].done == 6


def test_a_full_disk_leaves_nothing_half(tables, tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    out = tmp_path / 'out'
    with mock.patch.object(work, 'write_text', side_effect=full), \
            pytest.raises(OSError, match='No space'):
        run('import', tables, out)
    with mock.patch('microbot_ros.session.tables.folder.write_table', side_effect=full), \
            pytest.raises(OSError, match='No space'):
        run('import', tables, out)
    assert not (out / 'archive.parquet').exists()
    assert run('import', tables, out)[0].done == 5


def test_a_job_of_another_version_is_refused(tables, tmp_path):
    job = work.Job('import', 'table', tables / 't0.csv', (tables / 't0.csv',), 'abc', tmp_path,
                   settings('import'), version='0.0.1')
    with pytest.raises(work.VersionError, match=r'0\.1\.0; the client has 0\.0\.1'):
        work.do(job)


def test_a_damaged_index_is_named(laboratory, tmp_path):
    run('fit', laboratory, tmp_path / 'out')
    index = tmp_path / 'out' / '.microbot' / 'recordings.json'
    index.write_text('{"entries"')
    with pytest.raises(InputError, match='expected the index of an archive'):
        run('fit', laboratory, tmp_path / 'out')
    index.unlink()
    assert run('fit', laboratory, tmp_path / 'out')[0].kept == 6


def test_the_command(laboratory, tmp_path, capsys):
    (laboratory / 'bad.csv').write_text('a,b\n1,2\n')
    out, told = tmp_path / 'out', tmp_path / 'told.json'
    assert microbot('batch', 'fit', laboratory, '--out', out, '--json', told) == 0
    content = json.loads(told.read_text())
    assert (content['done'], content['sessions'], content['particles']) == (6, 6, 12)
    said = capsys.readouterr()
    assert '6 sessions, 12 particles' in said.out
    assert 'bad.csv' in said.err
    html = (out / 'archive.html').read_text()
    assert 'laboratory' not in html.split('Files that could not be read')[0]
    assert html.count('<img') >= 1


def test_a_report_that_fails_leaves_the_table_and_is_tried_again(laboratory, tmp_path, capsys):
    out, told = tmp_path / 'out', tmp_path / 'told.json'
    out.mkdir()
    (out / 'archive.html').write_text('of other results')
    with mock.patch('microbot_ros.archive.conclusions.report.page',
                    side_effect=ValueError('no\nφ')):
        assert microbot('batch', 'fit', laboratory, '--out', out, '--json', told) == 1
    said = capsys.readouterr()
    assert 'archive.html: not written, ValueError: no' in said.err.splitlines()[-1]
    assert json.loads(told.read_text())['done'] == 6
    assert len(read_table(out)['session']) == 12
    assert not (out / 'archive.html').exists()
    assert microbot('batch', 'fit', laboratory, '--out', out) == 0
    assert (out / 'archive.html').is_file()


def test_a_night_without_a_terminal_tells_how_far_it_is_once_a_minute():
    written, seconds = io.StringIO(), [0.0]
    shown = _Shown(Console(file=written, soft_wrap=True), lambda: seconds[0])
    for done in range(13):
        seconds[0] = 20.0 * done
        shown.report(batch.Progress('discover', done, 13, seconds[0]))
    assert written.getvalue().splitlines() == [
        f'discover: {done} of 13, 3.0 a minute, {minutes}:20 left'
        for done, minutes in ((3, 3), (6, 2), (9, 1), (12, 0))]
    shown.report(batch.Progress(note='t0.csv: a sentence'))
    assert written.getvalue().endswith('\nt0.csv: a sentence\n')
    screen = io.StringIO()
    on_screen = _Shown(Console(file=screen, force_terminal=True), lambda: seconds[0])
    seconds[0] += 1e3
    on_screen.report(batch.Progress('discover', 1, 2, 1.0))
    assert screen.getvalue() == ''


def test_a_result_that_is_damaged_is_made_again(laboratory, tmp_path):
    run('fit', laboratory, tmp_path / 'out')
    damaged = sorted((tmp_path / 'out').rglob('fit-*.json'))[:2]
    damaged[0].write_text('')
    damaged[1].write_text('{"particles": [')
    summary, found = run('fit', laboratory, tmp_path / 'out')
    assert (summary.done, summary.kept, found['sessions']) == (2, 4, 6)
