"""Bad input to every command that reads: status 2, one short line, and nothing left behind."""

from __future__ import annotations

import gc
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import pytest
from command_line import microbot
from session.recordings import record

from microbot_ros.cli import main
from microbot_ros.session import read_session
from microbot_ros.session.mcap.writer import MAGIC

LONG = 'x' * 9000
HEADER = 't_s,particle,x_um,y_um\n'
ROWS = ''.join(f'{k / 10:.1f},0,{k},{-k}\n' for k in range(30))
COMMANDS = 't_s,bx_mT,by_mT\n'
SCENARIO = """
duration_s: 2
radius_um: 2
reference_field_mT: 5
fluid: {viscosity_mPa_s: 1.0}
camera: {frame_rate_hz: 20}
particles: [{x_um: 0, y_um: 0, v_um_s: 3, phi_rad: 0}]
commands: {rotating: {field_mT: 5, period_s: 4}}
"""


def bomb(levels: int = 9) -> str:
    """Nine aliases in each of nine levels: three hundred million strings, written out."""
    lines = ['a0: &a0 [lol]']
    lines += [f'a{k + 1}: &a{k + 1} [{", ".join([f"*a{k}"] * 9)}]' for k in range(levels)]
    return '\n'.join(lines)


# What no YAML file of ours may hold, whatever is read from it.
YAML = {
    'billion laughs': bomb(),
    'empty but for a list': '- 1\n',
    'within itself': 'a: &a [*a]\n',
    'deep': '[' * 5000 + ']' * 5000,
    'deep mappings': '{a: ' * 5000,
    'digits': 'radius_um: ' + '9' * 6000,
    'hexadecimal digits': 'radius_um: 0x' + 'f' * 6000,
    'a key twice': 'radius_um: 1\nradius_um: 2\n',
    'no date': 'radius_um: 2001-99-99\n',
    'no number': 'radius_um: !!int x\n',
    'code': 'radius_um: !!python/object/apply:os.system [ls]\n',
    'a zero byte': 'radius_um: \0\n',
    'no text': b'radius_um: \xff\xfe\n',
    'a long text': f'radius_um: "{"x" * 100_000}"\n',
    'a long key': f'{"x" * 100_000}: 1\n',
    'a line in a key': '"radius\\n_um": 1\n',
    'a bell': 'radius_um: "\\a\\e[2J"\n',
    'unfinished': 'radius_um: [1, 2\n',
    'too large': '# ' + 'x' * 2**24,
}
# Files named to a command that reads YAML → its words.
YAML_READERS: dict[str, Callable[[Path, Path], list[object]]] = {
    'simulate': lambda bad, out: ['simulate', bad, '--out', out],
    'run': lambda bad, _: ['run', '--config', bad],
    'doctor': lambda bad, _: ['doctor', '--config', bad],
    'calibrate coils': lambda bad, out: [
        'calibrate', 'coils', bad, '--config', bad, '--out', out],
    'calibrate camera': lambda bad, out: [
        'calibrate', 'camera', '--particles', bad, '--diameter-um', 3, '--config', bad,
        '--out', out],
    'track': lambda bad, out: ['track', bad, '--settings', bad, '--out', out],
    'batch track': lambda bad, out: ['batch', 'track', bad, '--settings', bad, '--out', out],
    'reach': lambda bad, _: ['reach', '--model', bad, '--at', '0,0', '--goal', '9,0'],
}
SESSION_READERS: dict[str, Callable[[Path, Path], list[object]]] = {
    'info': lambda bad, out: ['info', bad, '--json', out],
    'fit': lambda bad, out: ['fit', bad, '--out', out],
    'discover': lambda bad, out: ['discover', bad, '--out', out],
    'response': lambda bad, out: ['response', bad, '--out', out],
    'replay': lambda bad, _: ['replay', bad],
    'calibrate camera': lambda bad, out: ['calibrate', 'camera', bad, '--out', out],
}
TRACKS = {
    'time': '1e300,0,1,1\n', 'time back': '-1e300,0,1,1\n', 'apart': '1e9,0,1,1\n',
    'position': '9,0,1e300,1\n', 'far': '9,0,1,1e15\n', 'infinite': '9,0,inf,1\n',
    'nowhere': '9,0,nan,1\n', 'negative': '9,-1,1,1\n', 'half': '9,0.5,1,1\n',
    'large': '9,1e20,1,1\n', 'digits': f'9,0,1{"0" * 6000},1\n', 'twice': '9,0,1,1\n9,0,1,1\n',
    'cells': '9,0,1\n', 'text': f'9,0,{"x" * 9000},1\n',
}
FIELDS = {
    'time': '1e300,1,1\n', 'apart': '-1e9,1,1\n', 'field': '0,1e300,1\n', 'strong': '0,1,1e9\n',
    'infinite': '0,inf,1\n', 'back': '1,1,1\n0,1,1\n', 'late': '99,1,1\n',
}
RECORDINGS = {
    'empty': b'', 'rubbish': random.Random(1).randbytes(5000),
    'rubbish with a head': MAGIC + random.Random(2).randbytes(5000),
    'rubbish after a header': MAGIC + b'\1' + (20).to_bytes(8, 'little') + bytes(20)
    + random.Random(3).randbytes(5000),
    'head alone': MAGIC,
}
SCENARIOS = {
    'duration': 'duration_s: 1e12', 'infinite': 'duration_s: .inf', 'frames': 'duration_s: 9e6',
    'negative': 'duration_s: -1', 'rate': 'camera: {frame_rate_hz: 1e300}',
    'slow': 'camera: {frame_rate_hz: 1e-300}', 'place': 'particles: [{x_um: 1e300, y_um: 0, '
    'v_um_s: 3, phi_rad: 0}]', 'fluid': 'fluid: {viscosity_mPa_s: 1e-300}',
    'small': 'radius_um: 1e-300', 'field': 'reference_field_mT: 1e300',
    'drift': 'effects: {uniform_drift: {wx_um_s: 1e300, wy_um_s: 0}}',
    'steps': 'commands: {steps: {field_mT: 5, dwell_s: [1e-9, 1]}}',
    'row': 'commands: {rows: [{t_s: 1e300, field_mT: 1, direction_deg: 0}]}',
}
OPTIONS: dict[str, list[object]] = {
    'pixel size': ['track', 'PICTURES', '--pixel-size-um', '1e308', '--out', 'OUT'],
    'frame rate': ['track', 'PICTURES', '--frame-rate-hz', '1e308', '--out', 'OUT'],
    'pixel size of tables': ['import', 'SESSION', '--pixel-size-um', '1e308', '--out', 'OUT'],
    'full scale of a field': ['import', 'SESSION', '--full-scale-mT', 'nan', '--out', 'OUT'],
    'exposure': ['fit', 'SESSION', '--exposure-ms', '1e308', '--out', 'OUT'],
    'jobs': ['discover', 'SESSION', '--jobs', '0', '--out', 'OUT'],
    'rate': ['replay', 'SESSION', '--rate', '-1'],
    'start': ['replay', 'SESSION', '--start', '1e300'],
    'frame that is not there': ['track', 'PICTURES', '--like', '9,40,60', '--out', 'OUT'],
    'point off the picture': ['track', 'PICTURES', '--like', '0,1e300,1', '--out', 'OUT'],
    'point nowhere': ['track', 'PICTURES', '--unlike', '0,nan,1', '--out', 'OUT'],
    'point at nothing': ['track', 'PICTURES', '--like', '0,150,110', '--out', 'OUT'],
    'point of digits': ['track', 'PICTURES', '--like', f'{"9" * 6000},1,1', '--out', 'OUT'],
    'kind with a bell': ['track', 'PICTURES', '--like', '0,40,60,\a\x1b[2J', '--out', 'OUT'],
    'kind of two lines': ['track', 'PICTURES', '--like', '0,40,60,a\nb', '--out', 'OUT'],
    'pixel size of films': ['batch', 'track', 'PICTURES', '--pixel-size-um', '1e308',
                            '--out', 'OUT'],
    'exposure of sessions': ['batch', 'fit', 'SESSION', '--exposure-ms', 'inf', '--out', 'OUT'],
    'column of tables': ['batch', 'import', 'SESSION', '--column', 'x', '--out', 'OUT'],
    'no workers': ['batch', 'discover', 'SESSION', '--workers', '0', '--out', 'OUT'],
    'two kinds of workers': ['batch', 'fit', 'SESSION', '--workers', '1', '--scheduler', 'x',
                             '--out', 'OUT'],
    'a file for an archive': ['batch', 'fit', 'SESSION', '--out', 'SESSION/tracks.csv'],
    'demo without end': ['demo', '--seconds', 'inf', '--out', 'OUT'],
    'demo of ages': ['demo', '--seconds', '1e300', '--out', 'OUT'],
    'seed of digits': ['demo', '--seed', '9' * 6000, '--out', 'OUT'],
    'repetitions': ['paper', '--repetitions', '0', '--out', 'OUT'],
    'minutes': ['discover', '--drive', '--minutes', 'nan', '--out', 'OUT'],
    'looks': ['discover', '--live', '--rounds', '-1', '--out', 'OUT'],
    'port of the page': ['cockpit', '--port', '65536'],
    'name of a rig': ['cockpit', '--namespace', 'a\nb'],
    'rig to arm': ['arm', '--namespace', '2 rigs'],
    'rig to record': ['record', '--namespace', 'x' * 9000],
    'rig to set': ['set', 'controller', 'controller', 'hold', '--namespace', '-'],
    'full scale': ['emulate', 'serial_transfer', '--link', 'OUT', '--full-scale-A', 'inf'],
    'fault of words': ['emulate', 'serial_transfer', '--link', 'OUT', '--fault', 'x' * 9000],
    'goal': ['goal', '1e300,0'], 'goal of words': ['goal', 'x' * 9000],
    'seconds': ['reach', '--seconds', '1e308'],
    'spacing': ['calibrate', 'camera', '--graticule', 'SESSION', '--spacing-um', '1e308',
                '--out', 'OUT'],
    'a line in an option': ['fit', 'SESSION', '--a\nb'], 'a line in a command': ['a\nb'],
    'a line in a path': ['info', 'a\nb\x1b[2J'],
    'a line in a session': ['fit', 'a\nb', '--out', 'OUT'],
    'no text in a path': ['info', 'a\udcff'],
    'a file for a folder': ['fit', 'SESSION', '--out', 'SESSION/tracks.csv'],
    'a file for the folder of a search': ['discover', 'SESSION', '--out', 'SESSION/tracks.csv'],
    'a folder for a file': ['discover', 'SESSION', '--out', 'OUT', '--json', 'SESSION'],
    'a folder for a film': ['replay', 'SESSION', '--film', 'SESSION'],
    'no path': ['fit', '', '--out', 'OUT'], 'no folder': ['fit', 'SESSION', '--out', ''],
    'a path through a file': ['fit', 'SESSION', '--out', 'SESSION/tracks.csv/out'],
    'a long name': ['fit', 'SESSION', '--out', 'x' * 300],
}


@pytest.fixture
def out(tmp_path: Path) -> Iterator[Path]:
    """A name to write to, in a folder of which the test must leave nothing."""
    folder = tmp_path / 'results'
    folder.mkdir()
    yield folder / 'out'
    assert not list(folder.iterdir())


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line of a command that is given bad input."""
    assert microbot(*words) == 2
    said = capsys.readouterr()
    assert said.out == ''
    (line,) = said.err.splitlines()
    assert line.startswith('microbot')
    assert line.isprintable()
    longest = max(len(str(word)) for word in words)
    assert len(line) <= 700 + longest
    return line


def session(folder: Path, tracks: str = HEADER + ROWS, commands: str = '') -> Path:
    folder.mkdir()
    (folder / 'tracks.csv').write_text(tracks)
    (folder / 'commands.csv').write_text(COMMANDS + (commands or '0,5,0\n1,0,5\n'))
    return folder


def once(readers, contents, *thorough):
    """All `contents` for the `thorough` readers, and one of them for each of the others.

    All YAML goes through `files.load_yaml`, and all sessions through `session.read_session`.
    """
    first = next(iter(contents))
    return pytest.mark.parametrize(('command', 'name'), [
        *((command, name) for command in thorough for name in contents),
        *((command, first) for command in readers if command not in thorough)])


def put(file, content):
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file


@once(YAML_READERS, YAML, 'simulate', 'reach')
def test_yaml_that_nobody_writes(tmp_path, out, capsys, command, name):
    bad = put(tmp_path / 'bad.yaml', YAML[name])
    refused(capsys, *YAML_READERS[command](bad, out))


@once(SESSION_READERS, YAML, 'info')
def test_session_yaml_that_nobody_writes(tmp_path, out, capsys, command, name):
    bad = session(tmp_path / 'bad')
    put(bad / 'session.yaml', YAML[name])
    assert 'session.yaml' in refused(capsys, *SESSION_READERS[command](bad, out))


@once(SESSION_READERS, TRACKS, 'info')
def test_tracks_that_no_rig_has(tmp_path, out, capsys, command, name):
    bad = session(tmp_path / 'bad', HEADER + ROWS + TRACKS[name])
    assert 'tracks.csv:3' in refused(capsys, *SESSION_READERS[command](bad, out))


@once(SESSION_READERS, FIELDS, 'info')
def test_commands_that_no_rig_has(tmp_path, out, capsys, command, name):
    bad = session(tmp_path / 'bad', commands=FIELDS[name])
    assert 'commands.csv:' in refused(capsys, *SESSION_READERS[command](bad, out))


@once(SESSION_READERS, RECORDINGS, 'info')
def test_files_that_are_no_recording(tmp_path, out, capsys, command, name):
    bad = put(tmp_path / 'bad.mcap', RECORDINGS[name])
    assert 'bad.mcap' in refused(capsys, *SESSION_READERS[command](bad, out))


@pytest.mark.parametrize('line', SCENARIOS.values(), ids=SCENARIOS)
def test_scenarios_that_nobody_can_simulate(tmp_path, out, capsys, line):
    key = line.partition(':')[0]
    kept = [one for one in SCENARIO.splitlines() if not one.startswith(f'{key}:')]
    bad = tmp_path / 'bad.yaml'
    bad.write_text('\n'.join([*kept, line]))
    refused(capsys, 'simulate', bad, '--out', out)


@pytest.mark.parametrize('words', OPTIONS.values(), ids=OPTIONS)
def test_options_that_cannot_be(tmp_path, out, capsys, words):
    places = {'SESSION': str(session(tmp_path / 'session')), 'OUT': str(out),
              'PICTURES': str(pictures(tmp_path, 2))}
    for name, place in places.items():
        words = [str(word).replace(name, place) for word in words]
    refused(capsys, *words)


BATCHES: dict[str, list[object]] = {
    'empty folder': ['EMPTY'], 'no folder': ['EMPTY/none'], 'a line in a folder': ['a\nb'],
    'labels': ['LABELLED'], 'long labels': ['LONG'], 'no day': ['DAY'], 'no label': ['KEY'],
    'no port of the scheduler': ['SESSION', '--scheduler', 'nowhere'],
    'a line in the scheduler': ['SESSION', '--scheduler', 'a\nb'],
}


@pytest.mark.parametrize('words', BATCHES.values(), ids=BATCHES)
def test_archives_of_nothing(tmp_path, capfd, words):
    pytest.importorskip('distributed')
    labelled = session(tmp_path / 'labelled')
    (labelled / 'archive.yaml').write_text(bomb())
    (tmp_path / 'empty').mkdir()
    places = {'SESSION': session(tmp_path / 'session'), 'EMPTY': tmp_path / 'empty',
              'LABELLED': labelled}
    for name, label in {'LONG': f'rig: [{LONG}]', 'DAY': f'recorded: {LONG}',
                        'KEY': f'{{{LONG}: 1}}'}.items():
        places[name] = session(tmp_path / name)
        (places[name] / 'archive.yaml').write_text(label)
    for name, place in places.items():
        words = [str(word).replace(name, str(place)) for word in words]
    assert microbot('batch', 'fit', *words, '--out', tmp_path / 'archive') == 2
    gc.collect()  # what was thrown away has its last word
    said = capfd.readouterr()
    assert said.out == ''
    assert len(said.err.splitlines()) == 1, said.err
    assert LONG[:81] not in said.err
    assert not (tmp_path / 'archive').exists()


def test_no_command_is_left_out():
    """Every one stands in a table above; a new one belongs there too."""
    from microbot_ros.cli import _COMMANDS

    tables = [list(words) for words in OPTIONS.values()]
    tables += [words(Path(), Path()) for readers in (YAML_READERS, SESSION_READERS)
               for words in readers.values()]
    assert set(_COMMANDS) <= {words[0] for words in tables}


def test_no_damage_to_a_recording_is_more_than_a_line(tmp_path, capsys):
    """Bits flipped and bytes lost anywhere: what is told may be wrong, but it is told."""
    whole = (Path(__file__).parents[1] / 'data' / 'steering.mcap').read_bytes()
    chance, bad = random.Random(5), tmp_path / 'bad.mcap'
    for _ in range(60):
        content = bytearray(whole)
        for _ in range(chance.randrange(1, 4)):
            place = chance.choice((chance.randrange(len(whole)), chance.randrange(200),
                                   len(whole) - chance.randrange(1, 2000)))
            content[place:place + 8] = chance.choice((b'\xff' * 8, bytes(8), chance.randbytes(8)))
        bad.write_bytes(content[:chance.choice((len(whole), chance.randrange(len(whole))))])
        status = microbot('info', bad)
        said = capsys.readouterr()
        assert status in (0, 2)
        assert len(said.err.splitlines()) == (status == 2), said.err


@pytest.mark.parametrize('command', ['fit', 'discover'])
def test_data_that_were_cut_off_are_said_to_be(tmp_path, capsys, command):
    simulated(tmp_path / 'plain')
    capsys.readouterr()
    (file,) = record(tmp_path / 'whole', read_session(tmp_path / 'plain')).glob('*.mcap')
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(file.read_bytes()[:-40])
    assert microbot(command, cut, '--out', tmp_path / 'out') == 0
    assert 'cut off' in capsys.readouterr().out


def simulated(folder: Path, seconds: int = 20) -> None:
    scenario = folder.with_suffix('.yaml')
    scenario.write_text(SCENARIO.replace('duration_s: 2', f'duration_s: {seconds}'))
    assert microbot('simulate', scenario, '--out', folder) == 0


def pictures(folder: Path, count: int) -> Path:
    """So many pictures with a dark dot that wanders."""
    place = folder / 'pictures'
    place.mkdir()
    y, x = np.mgrid[:120, :160]
    for k in range(count):
        dot = np.exp(-((x - 40 - k % 80) ** 2 + (y - 60) ** 2) / 18)
        noise = np.random.default_rng(k).normal(0, 2, dot.shape)
        cv2.imwrite(str(place / f'{k}.png'), (180 - 100 * dot + noise).astype(np.uint8))
    return place


def test_nothing_is_replaced_unless_told(tmp_path, capsys):
    simulated(tmp_path / 'plain')
    again = ['simulate', tmp_path / 'plain.yaml', '--out', tmp_path / 'plain']
    fit = ['fit', tmp_path / 'plain', '--out', tmp_path / 'fit']
    assert microbot(*fit) == 0
    capsys.readouterr()
    for name in ('found', 'tracks'):
        (tmp_path / name).mkdir()
    for words, file in (
            (again, tmp_path / 'plain' / 'tracks.csv'), (fit, tmp_path / 'fit' / 'fit.json'),
            (['discover', tmp_path / 'plain', '--out', tmp_path / 'found'],
             tmp_path / 'found' / 'report.html'),
            (['discover', '--drive', '--out', tmp_path / 'found'],
             tmp_path / 'found' / 'experiment-2'),
            (['track', tmp_path, '--out', tmp_path / 'tracks'],
             tmp_path / 'tracks' / 'learned.yaml')):
        file.write_text('mine')
        assert '--force' in refused(capsys, *words)
        assert file.read_text() == 'mine'
    assert microbot(*again, '--force') == 0
    assert microbot(*fit, '--force') == 0
    assert (tmp_path / 'fit' / 'fit.json').read_text() != 'mine'


_LIMITED = ('import resource, sys; from microbot_ros.cli import main; '
            'resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500)); '
            "sys.argv[0] = 'microbot'; main()")


@pytest.mark.rig
@pytest.mark.parametrize('command', ['simulate', 'track', 'discover'])
def test_a_full_disk_is_one_sentence(tmp_path, out, command):
    """The system lets no file be larger than 500 bytes, which it says as it says of a full disk.

    Without bytecode: Python itself would keep what it could write of it, for all who come later.
    """
    if command == 'track':
        source = pictures(tmp_path, 8)
    else:
        source = tmp_path / 'plain'
        simulated(source, 5 if command == 'simulate' else 20)
    given = source.with_suffix('.yaml') if command == 'simulate' else source
    done = subprocess.run([sys.executable, '-B', '-c', _LIMITED, command, given, '--out', out],
                          capture_output=True, text=True, timeout=100)
    # Before that it may say that code is compiled first.
    *before, line = done.stderr.splitlines()
    assert not any('microbot: ' in one for one in before), before
    assert 'File too large' in line
    assert done.returncode == 1


def test_a_file_that_ends_too_soon_is_no_ctrl_c(tmp_path, monkeypatch):
    """Python's own compiled files are such, where the disk was full when they were written."""
    path = tmp_path / 'rig.yaml'
    path.write_text('{}')
    cut_off = mock.Mock(side_effect=EOFError('cut off'))
    monkeypatch.setattr('microbot_ros.common.strict_yaml.load', cut_off)
    with pytest.raises(EOFError, match='cut off'), \
            mock.patch.object(sys, 'argv', ['microbot', 'simulate', str(path), '--out', 'none']):
        main()


@pytest.mark.rig
@pytest.mark.parametrize('command', ['track', 'paper'])
def test_a_signal_leaves_no_hidden_folder(tmp_path, out, command):
    words = [pictures(tmp_path, 2000)] if command == 'track' else ['--repetitions', 1000]
    process = subprocess.Popen([sys.executable, '-m', 'microbot_ros.cli', command,
                                *map(str, words), '--out', str(out)], stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60
        while not list(out.parent.glob('.out.*')):
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 128 + signal.SIGTERM
    finally:
        process.kill()
        process.wait()
