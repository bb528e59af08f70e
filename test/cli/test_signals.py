"""A signal to a command that comes where Python hears no exception."""

import signal
import subprocess
import sys

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
    ('SIGTERM', 'swallowed', -signal.SIGALRM)])
def test_a_command_ends_though_nobody_hears_of_its_signal(
        name: str, way: str, status: int) -> None:
    done = subprocess.run([sys.executable, '-c', _COMMAND.format(name=name, way=way)],
                          capture_output=True, timeout=50)
    assert done.returncode == status
    assert done.stderr.strip() == b''
