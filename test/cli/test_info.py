"""`microbot info` from the outside."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from microbot_ros import cli
from microbot_ros.common.errors import InputError
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording

TRACKS = 't_s,particle,x_um,y_um\n' + ''.join(
    f'{i / 10},{k},{i},{k}\n' for i in range(30) if i != 7 for k in (0, 1))
COMMANDS = 't_s,bx_mT,by_mT\n0,2,0\n1,0,2\n2,-2,0\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / 'tracks.csv').write_text(TRACKS)
    (tmp_path / 'commands.csv').write_text(COMMANDS)
    return tmp_path


def run(*words: object) -> str:
    result = CliRunner().invoke(
        cli.microbot, ['info', *map(str, words)], catch_exceptions=False, standalone_mode=False)
    assert not result.exception, result.exception
    return result.output


def test_a_folder_is_shown_written_and_drawn(folder, tmp_path):
    text = run(folder, '--json', tmp_path / 'a.json', '--figure', tmp_path / 'a.png')
    assert '2 particles in 29 frames, 1 frames missing' in text
    assert '3 commands at 2 mT, 2 turns left and 0 right' in text
    found = json.loads((tmp_path / 'a.json').read_text())
    assert found['excitation']['magnitudes_mT'] == [2]
    assert found['duration_s'] == pytest.approx(2.9)
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
    (folder / 'commands.csv').write_text('t_s,bx_mT,by_mT\n0,2,0\n')
    assert 'φ and drift cannot be distinguished' in ' '.join(run(folder).split())


def test_a_recording_that_was_cut_off_is_shown_and_repaired(tmp_path):
    with RecordingWriter(tmp_path / 'run') as writer:
        writer.write('/x', 'std_msgs/msg/Bool', 1, b'\x00\x01\x00\x00\x01')
    file = tmp_path / 'run' / 'run_0.mcap'
    file.write_bytes(file.read_bytes()[:-20])
    (tmp_path / 'run' / 'metadata.yaml').unlink()
    text = run(tmp_path / 'run')
    assert 'cut off' in text
    assert '/x' in text
    assert 'wrote the index' in run(tmp_path / 'run', '--repair')
    with Recording(tmp_path / 'run') as recording:
        assert recording.complete
    assert 'cut off' not in run(tmp_path / 'run')


@pytest.mark.parametrize('text', ['[/camera/image_raw, /x]', '[old] run', '[bold]a[/bold]'])
def test_brackets_in_names_and_notes_are_printed_as_they_are(tmp_path, text):
    with RecordingWriter(tmp_path / 'run [old][/x]') as writer:
        writer.describe('notes', {'comment': text})
        writer.write('/x', 'std_msgs/msg/Bool', 1, b'\x00\x01\x00\x00\x01')
    told = run(tmp_path / 'run [old][/x]')
    assert f'{tmp_path.name}/run [old][/x]' in ''.join(told.splitlines())
    assert text in told


@pytest.mark.parametrize(('words', 'said'), [
    (['nowhere'], 'found nothing'), (['{}', '--repair'], 'expected a recording to repair'),
    (['{}', '--figure', '{}/a.exe'], 'picture format'),
])
def test_bad_input_is_one_line_and_exit_2(folder, words, said):
    with pytest.raises(InputError, match=said) as refusal:
        run(*(word.format(folder) for word in words))
    assert '\n' not in str(refusal.value)


def test_nothing_is_compiled_for_it(folder: Path, tmp_path: Path) -> None:
    """The first command that a person tries on their own data answers at once."""
    cache = tmp_path / 'cache'
    subprocess.run([sys.executable, '-m', 'microbot_ros.cli', 'info', str(folder)], check=True,
                   env={**os.environ, 'NUMBA_CACHE_DIR': str(cache)}, timeout=60)
    assert not cache.exists()
