"""The first process of the container, which must outlive the sentinel and pass signals on."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.rig

ENTRYPOINT = Path(__file__).parents[2] / 'docker_entrypoint.sh'
_WAITING = ('import signal, sys, time\n'
            'signal.signal(signal.SIGTERM, lambda *_: (print("told", flush=True), sys.exit(7)))\n'
            'print("ready", flush=True)\n'
            'time.sleep(60)')


def start(*command):
    return subprocess.Popen([ENTRYPOINT, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                            text=True)


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM', 'SIGHUP'])
def test_a_signal_ends_the_command_and_its_status_comes_back(name):
    process = start(sys.executable, '-c', _WAITING)
    assert process.stdout.readline() == 'ready\n'
    process.send_signal(getattr(signal, name))
    assert process.communicate()[0] == 'told\n'
    assert process.returncode == 7


def test_it_outlives_a_command_that_is_killed():
    process = start(sys.executable, '-c', 'import os\nos.kill(os.getpid(), 9)')
    process.communicate()
    assert process.returncode == 128 + signal.SIGKILL


def test_a_sentinel_of_a_killed_command_ends_before_it():
    """A child that outlives the command for as long as a sentinel does is not cut short."""
    child = 'sleep 0.25; echo zeroed'
    process = start('bash', '-c', f'({child}) & kill -9 $$')
    assert process.stdout.readline() == 'zeroed\n'
    assert process.poll() is None  # as the end of the first process would kill it
    process.communicate()


def test_the_command_reads_standard_input():
    process = start('cat')
    assert process.communicate('typed\n')[0] == 'typed\n'
    assert process.returncode == 0
