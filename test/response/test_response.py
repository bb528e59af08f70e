"""`microbot response`: from sessions or an archive to table, figure, page and sentence."""

import csv
import json
import re
from datetime import UTC, datetime
from pathlib import Path
from unittest import mock

import numpy as np
import openpyxl
import pytest
from command_line import microbot
from laboratories import rolling_recording

from microbot_ros.cli.response import _labelled
from microbot_ros.response.result import Labelled, respond_all
from microbot_ros.response.words import difference, summary, unlike
from microbot_ros.session import write_session
from microbot_ros.session.mcap.recording import Recording

DATA = Path(__file__).parents[1] / 'data'
SHARED = Path(__file__).parents[2].parent / 'shared' / 'data' / 'speed_vs_frequency'
FILES = {'response.csv', 'response.json', 'response.parquet', 'response.png', 'response.pdf',
         'response.html'}
LEVELS = (1.0, 2.0, 4.0, 8.0, 12.0, 16.0)


def falling(f):
    """A roller that steps out at 6 Hz [m/s]."""
    return 3e-6 * f / (1 + (f / 6) ** 4)


@pytest.fixture(scope='module')
def archive(tmp_path_factory):
    """An archive of two kinds: rollers that step out, and some that do not."""
    folder = tmp_path_factory.mktemp('archive')
    (folder / '.microbot').mkdir()
    for kind, speed in (('stepping', falling), ('steady', None)):
        for seed in range(3):
            path = folder / 'sessions' / f'{kind}-{seed}'
            write_session(path, rolling_recording(LEVELS, seed, speed=speed, seconds=8.0,
                                                  robots=2))
            (path / 'archive.yaml').write_text(
                f'kind: {kind}\nrecorded: 2026-03-0{seed % 2 + 1}\n')
    return folder


def test_an_archive_becomes_a_table_a_figure_and_a_page(archive, tmp_path, capsys):
    parquet = pytest.importorskip('pyarrow.parquet')
    out = tmp_path / 'out'
    assert microbot('response', archive, '--out', out, '--json', tmp_path / 'r.json') == 0
    said = capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == FILES
    found = json.loads((out / 'response.json').read_text())
    assert found == json.loads((tmp_path / 'r.json').read_text())
    assert said.splitlines()[0] == found['sentence']
    assert '6 robots' in found['sentence']
    kinds = {one['kind']: one for one in found['kinds']}
    law = kinds['stepping']['law']
    assert law['steps_out']
    assert law['step_out_hz']['low_95'] < 6 < law['step_out_hz']['high_95']
    assert len(law['robots_stepping_out']) >= 4
    assert not kinds['steady']['law']['steps_out']
    assert {one['day'] for one in found['days']} == {'2026-03-01', '2026-03-02'}
    rows = list(csv.DictReader((out / 'response.csv').read_text().splitlines()))
    assert len(rows) == 2 * 3 * 2 * len(LEVELS)
    frame = parquet.read_table(out / 'response.parquet')
    assert frame['speed_um_s'].to_pylist() == pytest.approx(
        [float(row['speed_um_s']) for row in rows])
    page = (out / 'response.html').read_text()
    assert not re.search(r'\bnan\b|\binf\b', re.sub(r'base64,[^"]*', '', page))
    assert found['sentence'].split(';')[0].split(':')[0] in page
    assert found['difference'].split('.')[0] in page
    assert 'http' not in re.sub(r'base64,[^"]*', '', page)
    assert (out / 'response.png').read_bytes()[:4] == b'\x89PNG'


def test_a_session_that_cannot_be_read_is_left_out_of_an_archive(tmp_path, capsys):
    (tmp_path / 'a' / '.microbot').mkdir(parents=True)
    write_session(tmp_path / 'a' / 'sessions' / 'good', rolling_recording())
    film = tmp_path / 'a' / 'sessions' / 'film'
    film.mkdir()
    (film / 'tracks.csv').write_text('frame,particle,x_px,y_px\n0,0,1,1\n')
    assert microbot('response', tmp_path / 'a', '--out', tmp_path / 'o') == 0
    said = capsys.readouterr()
    assert 'left out' in said.err
    assert 'film/tracks.csv' in said.err
    assert '1 robot: speed goes' in said.out
    assert microbot('response', film, '--out', tmp_path / 'p') == 2


def test_sessions_of_one_name_are_robots_of_their_own_and_one_given_twice_is_one(tmp_path):
    slow, fast = (tmp_path / day / 'run1' for day in ('mon', 'tue'))
    other = tmp_path / 'other'
    for folder, gain in ((slow, 1e-6), (fast, 3e-6), (other, 2e-6)):
        write_session(folder, rolling_recording(gain=gain, slip=0.0))
    (tmp_path / 'link').symlink_to(slow)
    with mock.patch('microbot_ros.response.report.write') as write:
        assert microbot('response', slow, fast, other, slow, tmp_path / 'link', '--out',
                        tmp_path / 'out') == 0
    found = write.call_args.args[0]
    assert len(found.rows) == 9
    last = {row.robot: row.plateau.speed.value for row in found.rows if row.plateau.level == 5}
    assert last == pytest.approx(
        {(str(slow), 0): 5e-6, (str(fast), 0): 15e-6, ('other', 0): 10e-6}, rel=0.1)


@pytest.mark.parametrize('folder', [False, True])
def test_a_recording_is_of_the_day_of_its_clock(folder, tmp_path):
    source = DATA / 'tracking.mcap'
    if folder:
        source = tmp_path / 'run' / 'run_0.mcap'
        source.parent.mkdir()
        source.symlink_to(DATA / 'tracking.mcap')
    with Recording(source) as recording:
        day = datetime.fromtimestamp(recording.start_ns * 1e-9, UTC).date()
    assert _labelled(source.parent if folder else source).day == day.isoformat()


def test_a_robot_that_rests_at_the_first_level_has_no_share_that_it_loses():
    # Half a frame late, each step is by the command at its beginning: the rest is exact.
    session = rolling_recording(LEVELS, speed=lambda f: 3e-6 * f * (f > 1), delay=0.02,
                                seconds=4.0, noise=0.0, diffusion=0.0)
    found = respond_all([Labelled(session)], 'frequency', 'motion')
    assert found.kinds[0].common[0].speed.value == 0
    said = summary(found)
    assert said.startswith('1 robot: speed goes from 0 µm/s at 1 Hz to 48 µm/s at 16 Hz')
    assert said.endswith('no step-out up to 16 Hz.')


def test_nothing_is_replaced_without_being_asked(archive, tmp_path, capsys):
    out = tmp_path / 'out'
    session = archive / 'sessions' / 'steady-0'
    assert microbot('response', session, '--out', out) == 0
    assert microbot('response', session, '--out', out) == 2
    assert '--force' in capsys.readouterr().err
    assert microbot('response', session, '--out', out, '--force', '--definition', 'tables') == 0
    assert json.loads((out / 'response.json').read_text())['definition'] == 'tables'


def swimmers(tmp_path):
    path = tmp_path / 'swimmers'
    write_session(path, rolling_recording(frequency=False))
    return path


def empty(tmp_path):
    (tmp_path / 'archive' / '.microbot').mkdir(parents=True)
    return tmp_path / 'archive'


@pytest.mark.parametrize(('source', 'said'), [
    (swimmers, 'expected plateaus of the frequency, found none; nothing rotates: try --against'),
    (empty, 'expected an archive with sessions'),
    (lambda path: path / 'nowhere', 'found nothing'), (lambda path: path, 'tracks.csv')])
def test_what_holds_no_plateau_is_named_and_nothing_is_left(source, said, tmp_path, capsys):
    assert microbot('response', source(tmp_path), '--out', tmp_path / 'out') == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_swimmers_against_field(tmp_path, capsys):
    assert microbot('response', swimmers(tmp_path), '--out', tmp_path / 'o', '--against',
                    'field') == 0
    assert 'µm/s at 1 mT to 15 µm/s at 5 mT' in capsys.readouterr().out


def test_a_wrong_objective_is_flagged_within_its_kind():
    sessions = [Labelled(named(rolling_recording(seed=k, seconds=10.0,
                                                 gain=3e-6 * (0.35 if k == 4 else 1)), f's{k}'),
                         'robots') for k in range(6)]
    sessions += [Labelled(named(rolling_recording(seed=9, gain=9e-6), 'other'), 'large')]
    found = respond_all(sessions, 'frequency', 'motion')
    assert [one.robot for one in found.unlike] == [('s4', 0)]
    assert found.unlike[0].ratio == pytest.approx(0.35, rel=0.1)
    assert 'another objective or a wrong pixel size' in unlike(found.unlike[0])
    assert 'large, 1 robot:' in summary(found)
    assert difference(found).startswith('The tables state')


def named(session, name):
    return type(session)(session.tracks, session.commands, session.conditions, name)


def column_of(table, name):
    head, *body = list(openpyxl.load_workbook(table, data_only=True).active.values)
    k = head.index(name)
    return {float(row[0]): row[k] for row in body if row[k] is not None}


# Which recording is which robot of the laboratory's tables; those of the other columns are
# elsewhere.
COLUMNS = [
    ('1botcellbot_total.xlsx', 'robot 1 avg', 'cellbots/1botcellbot.xlsx'),
    ('1botcellbot_total.xlsx', 'robot 2 avg', 'cellbots/1botcellbot3.xlsx'),
    ('20umdimerspeedvsfreqdata.xlsx', 'robot 2 avg', 'dimers_20um/20umDimer4.xlsx'),
    ('20umdimerspeedvsfreqdata.xlsx', 'robot 3 avg', 'dimers_20um/20umDimer5.xlsx'),
    ('20umdimerspeedvsfreqdata.xlsx', 'robot 4 avg', 'dimers_20um/20umDimer6.xlsx')]


@pytest.mark.skipif(not SHARED.is_dir(), reason='the shared recordings are not here')
@pytest.mark.parametrize('columns', [
    COLUMNS[1:3], pytest.param(COLUMNS, marks=pytest.mark.soak)], ids=len)
def test_the_tables_of_the_laboratory_are_reproduced(tmp_path, columns):
    folders = []
    for _, _, source in columns:
        folders.append(tmp_path / Path(source).stem)
        assert microbot('import', SHARED / source, '--out', folders[-1]) == 0
    out = tmp_path / 'out'
    assert microbot('response', *folders, '--out', out, '--definition', 'tables') == 0
    rows = list(csv.DictReader((out / 'response.csv').read_text().splitlines()))
    for (table, name, _), folder in zip(columns, folders, strict=True):
        theirs = column_of(SHARED / table, name)
        ours = {float(row['frequency_hz']): float(row['speed_um_s'])
                for row in rows if row['session'] == folder.name}
        off = [abs(ours[f] / theirs[f] - 1) for f in theirs]
        assert len(off) >= 9
        assert np.median(off) <= 0.01
