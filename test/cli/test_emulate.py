"""`microbot emulate` as a process: its line, its log, its end, its complaints."""

import json
import os
import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.rig

COMMAND = [sys.executable, '-m', 'microbot_ros.cli', 'emulate', 'serial_transfer']


def run(*options: object) -> subprocess.CompletedProcess:
    return subprocess.run([*COMMAND, *map(str, options)], capture_output=True, text=True,
                          timeout=60)


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT])
def test_it_ends_with_zero_and_no_link(tmp_path, number):
    link, log = tmp_path / 'coils', tmp_path / 'log.jsonl'
    with subprocess.Popen([*COMMAND, '--link', link, '--log', log], stdout=subprocess.PIPE,
                          text=True) as process:
        assert process.stdout.readline() == f'serving serial_transfer at {link}\n'
        assert os.readlink(link).startswith('/dev/')
        process.send_signal(number)
        assert process.wait(20) == 0
    assert not link.is_symlink()
    entries = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(entry['currents_A'], entry['cause']) for entry in entries] == [([0.0] * 4, 'reset')]
    assert set(entries[0]) == {'t_monotonic_s', 'currents_A', 'cause'}


def test_it_takes_over_a_stale_link_and_leaves_files_alone(tmp_path):
    link = tmp_path / 'coils'
    link.symlink_to('/dev/pts/nowhere')
    with subprocess.Popen([*COMMAND, '--link', link], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        assert link.exists()
        process.terminate()
    link.write_text('precious')
    done = run('--link', link)
    assert (done.returncode, done.stdout) == (2, '')
    assert f'{link}: expected an unused path' in done.stderr
    assert link.read_text() == 'precious'


def test_it_takes_over_no_link_to_a_device_and_empties_no_file_but_a_log(tmp_path):
    link, log = tmp_path / 'coils', tmp_path / 'log.jsonl'
    link.symlink_to('/dev/null')
    log.write_text('t_s,particle\n')
    done = run('--link', link)
    assert (done.returncode, os.readlink(link)) == (2, '/dev/null')
    assert f'{link}: expected an unused path' in done.stderr
    done = run('--link', tmp_path / 'free', '--log', log)
    assert done.returncode == 2
    assert f'{log}: expected a new file' in done.stderr
    assert log.read_text() == 't_s,particle\n'
    written = '{"t_monotonic_s": 2.0, "currents_A": [0.0], "cause": "reset"}\n'
    log.write_text(written)
    assert run('--link', tmp_path / 'nowhere' / 'link', '--log', log).returncode == 2
    assert log.read_text() == written
    log.write_text('{"t_monotonic_s": 1.0, "currents_A": [0.0], "cause": "reset"}\n')
    with subprocess.Popen([*COMMAND, '--link', tmp_path / 'free', '--log', log],
                          stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        process.terminate()
    assert '"t_monotonic_s": 1.0,' not in log.read_text()


@pytest.mark.parametrize('options', [
    ['--fault', 'flop'], ['--fault', 'flip=2'], ['--fault', 'flip=nan'], ['--fault', 'open=17'],
    ['--fault', 'open=5'], ['--fault', 'silence/2'],
    ['--fault', 'open=1.5'], ['--fault', 'flip@'], ['--fault', 'unplug@1.2.3'],
    ['--watchdog-ms', '0'], ['--watchdog-ms', 'nan'], ['--watchdog-ms', 'inf'],
    ['--watchdog-ms', '50', '--no-watchdog'],
    ['--full-scale-A', '0'], ['--full-scale-A', 'nan'], ['--full-scale-A', '-1'],
    ['--log', '/nowhere/at/all'], ['--link', '/nowhere/at/all'],
])
def test_a_bad_option_is_one_line_and_leaves_nothing(tmp_path, options):
    done = run('--link', tmp_path / 'coils', *options)
    assert done.returncode == 2
    assert done.stdout == ''
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('option', [['--watchdog-ms', '50'], ['--no-watchdog']])
def test_a_watchdog_that_the_protocol_does_not_have_is_refused(tmp_path, option):
    done = subprocess.run([*COMMAND[:-1], 'modbus', '--link', tmp_path / 'coils', *option],
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert 'for serial_transfer only' in done.stderr
