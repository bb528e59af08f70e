"""Importing a laboratory's folder: options where they belong, counts that count, kinds apart."""

import json
import re
from dataclasses import replace
from datetime import date

import numpy as np
import pytest
import yaml
from click.testing import Result
from command_line import runner
from matplotlib.collections import PolyCollection

from microbot_ros import cli
from microbot_ros.archive import Archive, conclude
from microbot_ros.archive.conclusions.quantities import of_sessions, unlike_the_others
from microbot_ros.archive.conclusions.recurring import Recurring
from microbot_ros.archive.conclusions.report import draw_quantities, page
from microbot_ros.archive.imports import imported
from microbot_ros.archive.labels import labels_of, own_answers, stated
from microbot_ros.archive.recordings import Found
from microbot_ros.archive.store import Entry
from microbot_ros.archive.table import rows
from microbot_ros.archive.work import result_file
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import write_text
from microbot_ros.session import read_session


def table(path, size=0.5, speeds=True, frames=60, seed=0):
    """Positions in pixels of a robot on a walk, and its speeds in µm/s where it tells them."""
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(frames)
    x, y = 100 + np.cumsum(rng.normal(2, 1, (2, frames)), axis=1)
    v = np.r_[np.zeros(3), size * np.hypot(x[3:] - x[:-3], y[3:] - y[:-3]) / 0.15]
    names = ['time [s]', 'x', 'y', *(['Vel Mag'] if speeds else [])]
    rows = zip(t, x, y, *([v] if speeds else []), strict=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text('\n'.join([','.join(names), *(','.join(map(repr, map(float, row)))
                                                  for row in rows)]) + '\n')
    return path


SUMMARY = 'freq,robot 1 avg,robot 2 avg\n' + ''.join(f'{k},{k * 3.5},{k * 3.4}\n'
                                                     for k in range(1, 20))


@pytest.fixture
def folder(tmp_path):
    top = tmp_path / 'lab'
    for k in range(3):
        table(top / 'dimers' / f'd{k}.csv', 0.8, seed=k)
    table(top / 'dimers' / 'odd.csv', 0.4, seed=4)
    table(top / 'dimers' / 'mute.csv', speeds=False, seed=5)
    table(top / 'spheres' / 's.csv', 0.4, seed=6)
    (top / 'answers.csv').write_text(SUMMARY)
    return top


def call(*words) -> Result:
    return runner().invoke(cli.microbot, [*map(str, words)], standalone_mode=False)


def run(*words) -> Result:
    return call('batch', 'import', *words, '--workers', 1)


def test_a_folder_becomes_sessions_and_every_table_counts_once(folder, tmp_path):
    out = tmp_path / 'archive'
    done = run(folder, '--out', out, '--json', tmp_path / 'a.json')
    assert done.exception is None
    said, told = done.stdout, done.stderr
    assert '7 recordings: 5 done, 0 kept from before, 1 with averages only, 1 refused' in told
    assert 'lab/dimers/mute.csv: mute.csv: expected --position-unit' in told
    assert 'other files in the folder have 0.8 µm in 3, 0.4 µm in 1' in told
    assert f'{out}: 5 sessions in {out}/sessions' in said
    assert 'Warning' not in told
    assert 'lab/dimers has pixels of several sizes: 0.4 µm in 1, 0.8 µm in 3; different: ' \
           'odd.csv (0.4 µm).' in said
    found = json.loads((tmp_path / 'a.json').read_text())
    sentences = {one['sentence'] for one in found['imported']['assumed']}
    for session in (out / 'sessions').iterdir():
        content = yaml.safe_load((session / 'session.yaml').read_text())
        assert content['assumed']
        assert set(content['assumed']) <= sentences
        assert (session / 'tracks.csv').is_file()
    assert all(f'assumed  {one}' in said for one in sentences)
    kinds = {yaml.safe_load((one / 'archive.yaml').read_text())['kind']
             for one in (out / 'sessions').iterdir()}
    assert kinds == {'dimers', 'spheres'}
    again = run(folder, '--out', out)
    assert '0 done, 5 kept from before, 1 with averages only, 1 refused' in again.stderr


def test_tables_of_one_name_in_folders_of_one_name_count_each(tmp_path):
    out = tmp_path / 'archive'
    archive = Archive(out)
    for day, key in (('mon', 'import-aa'), ('tue', 'import-bb')):
        path = tmp_path / day / 'data'
        archive.entries[str(path / 'a.csv')] = Entry(
            'data/a.csv', 'table', str(path), day, [], jobs={'import': key})
        write_text(result_file(out, key), json.dumps(
            {'session': day, 'remarks': ['y points down'], 'pixel_size_um': 0.5}))
    found = imported(archive)
    assert found['sessions'] == 2
    assert found['assumed'] == [{'sentence': 'y points down', 'recordings': ['data/a.csv'] * 2}]
    assert found['pixel_sizes'] == {'data': {'0.5': ['data/a.csv'] * 2}}


def test_what_archive_yaml_states_of_a_file_counts_before_the_option(folder, tmp_path):
    (folder / 'archive.yaml').write_text(
        'kind: rollers\nfiles:\n  dimers/mute.csv:\n    pixel_size_um: 0.25\n'
        '  dimers:\n    kind: pairs\n')
    (folder / 'spheres' / 'archive.yaml').write_text(
        "files:\n  '*.csv':\n    pixel_size_um: 0.9\n    ignore_speed: true\n")
    out = tmp_path / 'archive'
    done = run(folder, '--out', out)
    assert '6 done' in done.stderr
    sizes = {path.name.rsplit('-', 1)[0]: read_session(path).conditions.pixel_size
             for path in (out / 'sessions').iterdir()}
    assert sizes['mute'] == 0.25e-6
    assert sizes['s'] == pytest.approx(0.9e-6)
    assert sizes['odd'] == pytest.approx(0.4e-6)
    kinds = {path.name.rsplit('-', 1)[0]: yaml.safe_load((path / 'archive.yaml').read_text())[
        'kind'] for path in (out / 'sessions').iterdir()}
    assert kinds == {name: 'rollers' if name == 's' else 'pairs' for name in sizes}
    assert imported(Archive(out))['sessions'] == 6


@pytest.mark.parametrize('verdict', ['searched', 'refused'])
def test_a_recording_that_was_fitted_and_its_copy_that_was_searched_are_one_row(
        tmp_path, verdict):
    one = {'value': 1.0, 'std': 0.1}
    baseline = {'particles': {'0': {'v_um_s': one}}, 'diffusion_um2_s': one}
    facts = {'propulsion': 'catalytic', 'duration_s': 1, 'frames': 3, 'remarks': []}
    told = {'fit-aa': {'facts': facts, 'fit': baseline}, 'discover-bb': {
        'searched': {'facts': facts, 'result': {'verdict': 'consistent', 'baseline': baseline}},
        'refused': {'refused': 'no'}}[verdict]}
    archive = Archive(tmp_path)
    for day, key in (('mon', 'fit-aa'), ('tue', 'discover-bb')):
        archive.entries[f'/{day}/run'] = Entry(f'{day}/run', 'session', f'/{day}', 'same', [],
                                               jobs={key[:-3]: key})
        write_text(result_file(tmp_path, key), json.dumps(told[key]))
    expected = ('tue/run', 'discover') if verdict == 'searched' else ('mon/run', 'fit')
    assert [(row['session'], row['task']) for row in rows(archive, {})] == [expected]


def test_a_conflict_with_a_stated_size_is_refused_and_nothing_is_written(folder, tmp_path):
    out = tmp_path / 'archive'
    done = run(folder / 'spheres', '--out', out, '--pixel-size-um', 0.5)
    assert "--pixel-size-um 0.5 contradicts 'Vel Mag' of" in done.stderr
    assert '0 done, 0 kept from before, 1 refused' in done.stderr
    assert not (out / 'sessions').exists()
    single = call('import', folder / 'spheres' / 's.csv', '--pixel-size-um', 0.5, '--out',
                      tmp_path / 's')
    assert isinstance(single.exception, InputError)
    assert not (tmp_path / 's').exists()


@pytest.mark.parametrize(('text', 'said'), [
    ('files:\n  a.csv:\n    pixel_size: 3\n', 'unknown key'),
    ('pixel_size_um: -1\n', 'pixel_size_um'), ('pixel_size_um: .nan\n', 'pixel_size_um'),
    ('pixel_size_um: .inf\n', 'pixel_size_um'), ('angle_offset_deg: .nan\n', 'angle_offset_deg'),
    ('columns:\n  z: here\n', 'expected roles of'), ('field_unit: furlong\n', 'field_unit'),
])
def test_a_wrong_archive_yaml_is_named(tmp_path, text, said):
    path = table(tmp_path / 'a.csv')
    (tmp_path / 'archive.yaml').write_text(text)
    with pytest.raises(InputError, match=said) as refusal:
        own_answers(Found(path, 'table', tmp_path, (path,)), {})
    assert refusal.value.source.endswith('archive.yaml')


def test_the_most_specific_statement_counts(tmp_path):
    path = table(tmp_path / 'year' / 'day' / 'b.csv')
    (tmp_path / 'archive.yaml').write_text(
        'rig: left\npixel_size_um: 0.1\nfiles:\n  year/day/b.csv:\n    rig: right\n')
    (tmp_path / 'year' / 'day' / 'archive.yaml').write_text(
        "pixel_size_um: 0.2\nfiles:\n  '*.csv':\n    pixel_size_um: 0.3\n    times: moments\n"
        '  b.csv:\n    pixel_size_um: 0.4\n')
    found = Found(path, 'table', tmp_path, (path,))
    said = stated(found)
    assert (said['pixel_size_um'], said['times'], said['rig']) == (0.4, 'moments', 'right')
    answers = own_answers(found, {'pixel_size': 1e-6, 'frame_rate': 20.0})
    assert (answers['pixel_size'], answers['frame_rate']) == (pytest.approx(0.4e-6), 20.0)
    assert labels_of(found).kind == 'day'
    # Folders by day are no kinds.
    path = table(tmp_path / 'dimers' / '2026-03-14' / 'c.csv')
    labels = labels_of(Found(path, 'table', tmp_path, (path,)))
    assert (labels.kind, str(labels.day)) == ('dimers', '2026-03-14')


def test_kinds_are_compared_each_with_its_own(tmp_path):
    """A kind of fast robots is not unlike a kind of slow ones, a slow one among the fast is."""
    value = np.array([10.0, 10.2, 9.9, 10.1, 9.8, 10.0, 30.0, 30.5, 29.7, 30.2, 29.9, 9.2])
    rows = [{'session': f's{k}', 'particle_kind': 'slow' if k < 6 else 'fast'}
            for k in range(12)]
    whole = of_sessions('v_um_s', rows, value, np.full(12, 0.2))
    unlike = unlike_the_others(whole.by_kind())
    assert [one.session for one in unlike] == ['s11']
    found = conclude(Archive(tmp_path))
    said = replace(found, unlike=unlike).sentences()
    assert said == ['s11 differs from the others: v (µm/s) 9.2, usually 26.6; another objective '
                    'or a wrong pixel size can cause that.']
    assert [part.of_kind for part in whole.by_kind()] == ['fast', 'slow']
    assert len(of_sessions('v_um_s', [{'session': 'a'}], value[:1], value[:1]).by_kind()) == 1


def test_the_page_compares_kinds_each_with_its_own(tmp_path):
    """The mean over fast and slow robots is that of no robot."""
    value = np.array([10.0, 10.2, 9.9, 30.0, 30.5, 29.7, 20.0])
    rows = [{'session': f's{k}', 'day': date(2026, 3, 1 + k % 2),
             **({'particle_kind': 'slow' if k < 3 else 'fast'} if k < 6 else {})}
            for k in range(7)]
    whole = of_sessions('gain_um_s_hz', rows, value, np.full(7, 0.2))
    assert whole.kinds() == [('fast', [3, 4, 5]), ('slow', [0, 1, 2]), ('', [6])]
    found = replace(conclude(Archive(tmp_path)), quantities=[whole])
    text = re.sub(r'<[^>]+>', ' ', page(Archive(tmp_path), found))
    table = ' '.join(text.split()).split('typical error of one ')[1]
    assert re.match(r'gain \(µm/s/Hz\) fast 3 30\.1 .* gain \(µm/s/Hz\) slow 3 10\.0', table)
    assert 'gain (µm/s/Hz) of fast by day' in text
    assert 'particle kind' not in text
    # A band for each kind, and none over all.
    figure = draw_quantities([whole])
    bands = [band.get_paths()[0].get_extents() for band in figure.axes[0].collections
             if isinstance(band, PolyCollection)]
    assert [(round(one.x0, 1), round(one.x1, 1)) for one in bands] == [
        (0.6, 3.4), (3.6, 6.4), (6.6, 7.4)]


def test_the_page_gives_the_parameters_of_an_effect_for_each_kind(tmp_path):
    value, error = np.array([0.10, 0.11, 0.10, 0.14, 0.15, 0.14]), np.full(6, 0.01)
    rows = [{'session': f's{k}', 'particle_kind': 'dimers' if k < 3 else 'spheres'}
            for k in range(6)]
    known = of_sessions('command_delay.delay_s', rows, value, error)
    effect = Recurring('command_delay', {f's{k}': 1.0 for k in range(6)}, (),
                       {'delay_s': known.spread}, {})
    assert replace(effect, probability={'s0': 1.0}).sentence() == \
        'command_delay in the only session.'
    found = replace(conclude(Archive(tmp_path)), effects=[effect],
                    parameters={'command_delay': [known]})
    text = ' '.join(re.sub(r'<[^>]+>', ' ', page(Archive(tmp_path), found)).split())
    assert re.search(r'delay \(s\) 0\.12\d? .* delay of dimers 0\.10\d? .* delay of spheres 0\.14',
                     text)
