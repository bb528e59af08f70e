"""A signal to a command that comes where Python hears no exception."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.rig

_COMMAND = """
import os, signal, sys, time, types
import click
from microbot_ros import cli

def killed(*_):
    os.kill(os.getpid(), signal.{name})
    time.sleep(0.001)

class Collected:
    __del__ = killed

def ignored_by_python():
    Collected()

def swallowed():
    try:
        killed()
    except BaseException:
        pass

def imported():
    import swallows

def imported_for_long():
    import swallows_for_long

@click.command()
def command():
    {way}()
    time.sleep(60)

cli._CLEAN_UP_S = 1
sys.modules['microbot_ros.cli.info'] = types.SimpleNamespace(command=command)
sys.argv = ['microbot', 'info']
cli.script()
"""


@pytest.mark.parametrize(('name', 'way', 'status'), [
    ('SIGTERM', 'ignored_by_python', 128 + signal.SIGTERM),
    ('SIGHUP', 'ignored_by_python', 128 + signal.SIGHUP),
    ('SIGINT', 'ignored_by_python', 130),
    ('SIGTERM', 'swallowed', -signal.SIGALRM),
    ('SIGTERM', 'imported', 128 + signal.SIGTERM),
    ('SIGINT', 'imported', 130),
    ('SIGHUP', 'imported_for_long', 128 + signal.SIGHUP),
    ('SIGINT', 'imported_for_long', 130)])
def test_a_command_ends_though_nobody_hears_of_its_signal(
        tmp_path: Path, name: str, way: str, status: int) -> None:
    (tmp_path / 'swallows.py').write_text('import __main__; __main__.swallowed()')
    (tmp_path / 'swallows_for_long.py').write_text('import swallows, time; time.sleep(60)')
    done = subprocess.run([sys.executable, '-c', _COMMAND.format(name=name, way=way)],
                          env={**os.environ, 'PYTHONPATH': str(tmp_path)},
                          capture_output=True, timeout=50)
    assert done.returncode == status
    assert done.stderr.strip() == b''
