"""`microbot import` from the outside."""

import json

import click
import pytest
from click.testing import CliRunner

from microbot_ros import cli
from microbot_ros.common.errors import InputError
from microbot_ros.session import read_session

TABLE = 't;x;y\n' + ''.join(f'{i * 0.05:.2f};{i}00,5;{i}\n'.replace('.', ',') for i in range(9))


def run(*words: object) -> str:
    result = CliRunner().invoke(
        cli.microbot, ['import', *map(str, words)], catch_exceptions=False, standalone_mode=False)
    if isinstance(result.exception, Exception):
        raise result.exception
    return result.output


@pytest.fixture
def table(tmp_path):
    (tmp_path / 'lab.csv').write_text(TABLE)
    return tmp_path / 'lab.csv'


def test_a_table_becomes_a_session_and_says_what_it_assumed(table, tmp_path):
    text = run(table, '--pixel-size-um', 0.5, '--out', tmp_path / 's', '--json',
               tmp_path / 'a.json')
    assert 'assumed  lab.csv: decimal commas' in text
    assert 'assumed  y points down' in text
    assert '1 robot, 9 positions over 0.4 s, 0 commands' in text
    session = read_session(tmp_path / 's')
    assert session.tracks.position[2].tolist() == pytest.approx([100.25e-6, -1e-6])
    assert session.conditions.pixel_size == 0.5e-6
    found = json.loads((tmp_path / 'a.json').read_text())
    assert found['particles'] == [0]
    assert len(found['assumed']) == len([row for row in text.splitlines() if 'assumed' in row])


def test_options_overrule_detection(table, tmp_path):
    run(table, '--position-unit', 'mm', '--y', 'down', '--time-unit', 'ms', '--column', 'x=y',
        '--column', 'y=x', '--out', tmp_path / 's')
    tracks = read_session(tmp_path / 's').tracks
    assert tracks.position[1].tolist() == pytest.approx([1e-3, -100.5e-3])
    assert tracks.t[1] == pytest.approx(0.05e-3)


def test_a_session_that_is_there_is_replaced_on_demand_only(table, tmp_path):
    words = table, '--pixel-size-um', 0.5, '--out', tmp_path / 's'
    run(*words)
    (tmp_path / 's' / 'commands.csv').write_text('t_s,bx_mT,by_mT\n0,1,0\n')
    kept = {path.name: path.read_bytes() for path in (tmp_path / 's').iterdir()}
    with pytest.raises(InputError, match='--force replaces'):
        run(*words)
    assert {path.name: path.read_bytes() for path in (tmp_path / 's').iterdir()} == kept
    run(*words, '--force')
    assert len(read_session(tmp_path / 's').commands.t) == 0


@pytest.mark.parametrize('source', ['', 'tracks.csv'])
def test_no_session_replaces_the_tables_that_it_is_made_of(table, tmp_path, source):
    table.rename(tmp_path / 'tracks.csv')
    with pytest.raises(InputError, match='another folder than that of the tables'):
        run(tmp_path / source, '--pixel-size-um', 0.5, '--out', tmp_path, '--force')
    assert [path.name for path in tmp_path.iterdir()] == ['tracks.csv']
    assert (tmp_path / 'tracks.csv').read_text() == TABLE


@pytest.mark.parametrize(('words', 'said'), [
    ([], '--position-unit'), (['--position-unit', 'px'], '--pixel-size-um'),
    (['--pixel-size-um', 'nan'], 'no number'), (['--pixel-size-um', '-1'], 'not in the range'),
    (['--pixel-size-um', 'inf'], 'not in'), (['--frame-rate-hz', '0'], 'not in the range'),
    (['--angle-offset-deg', 'nan'], 'nan is no number'),
    (['--column', 'z=x'], 'ROLE=NAME'), (['--column', 'x'], 'ROLE=NAME'),
])
def test_bad_options_are_named_and_nothing_is_written(table, tmp_path, words, said):
    with pytest.raises((InputError, click.BadParameter), match=said):
        run(table, *words, '--out', tmp_path / 's')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['lab.csv']


def test_a_column_that_is_named_and_missing_is_no_silent_loss(table, tmp_path):
    with pytest.raises(InputError, match=r"expected a column 'Angle' \(--column direction\), "
                                         'found none; known are: t, x, y$'):
        run(table, '--pixel-size-um', 0.5, '--column', 'direction=Angle', '--out', tmp_path / 's')
    assert not (tmp_path / 's').exists()
