"""Options of `microbot replay` and `discover` that are refused."""

import sys

import pytest
from click.testing import CliRunner

from microbot_ros.cli import main, microbot
from microbot_ros.common.errors import InputError
from microbot_ros.nodes.replay import Replay, ReplayPlan

TRACKS = 't_s,particle,x_um,y_um\n' + ''.join(f'{k / 10},0,{k},0\n' for k in range(30))


@pytest.mark.parametrize('end', ['-5', 'nan', 'inf'])
def test_an_end_that_is_none_is_named(tmp_path, end):
    with pytest.raises(InputError, match='--end: expected a time of 0 s or later'):
        Replay(tmp_path, tmp_path / 'out', ReplayPlan((), (), ''), {}, float(end))


@pytest.mark.parametrize(('options', 'said'), [
    (['--seconds', '99'], '--seconds only with --live'),
    (['--rounds', '2'], '--rounds only with --live'),
    (['--minutes', '3'], '--minutes only with --drive'),
    (['--namespace', 'rig_2'], '--namespace only with --live or --drive'),
    (['--drive', '--jobs', '2'], '--jobs only with SESSION or --live')])
def test_options_of_another_mode_are_refused(tmp_path, options, said):
    (tmp_path / 'tracks.csv').write_text(TRACKS)
    source = [] if '--drive' in options else [str(tmp_path)]
    done = CliRunner().invoke(
        microbot, ['discover', *source, '--out', str(tmp_path / 'o'), *options])
    assert done.exit_code == 2
    assert said in done.output


def test_json_replaces_json_only(tmp_path):
    (tmp_path / 'tracks.csv').write_text(TRACKS)
    there = tmp_path / 'result.json'
    there.write_text('{}\n')
    for file, refused in ((tmp_path / 'tracks.csv', True), (there, False)):
        done = CliRunner().invoke(microbot, ['info', str(tmp_path), '--json', str(file)])
        assert ('expected a new file or one of JSON' in done.output) == refused
        assert done.exit_code == 2 * refused, done.output
    assert (tmp_path / 'tracks.csv').read_text() == TRACKS
    assert there.read_text() != '{}\n'


def test_a_recording_that_is_stopped_gets_no_title():
    done = CliRunner().invoke(microbot, ['record', '--stop', '--title', 'batch 7'])
    assert done.exit_code == 2
    assert 'without --stop' in done.output


@pytest.mark.parametrize(('words', 'name'), [
    (['calibrate', 'camera', '--nothing'], 'microbot calibrate camera: '),
    (['batch', 'fit'], 'microbot batch fit: '), (['nothing'], 'microbot: ')])
def test_what_is_refused_is_named_with_its_group(words, name, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['microbot', *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith(name)
